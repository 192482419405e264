"""Motors of the library through what people do with them: tuned, written for firmware, run."""

from __future__ import annotations

from pathlib import Path

import pytest

from dqforge import cli
from dqforge.machines.design import catalogue
from dqforge.reports.answers.run import answer_export_for
from dqforge.reports.answers.tune import answer_tune
from dqforge.reports.firmware.target import TARGETS

# Whose users have which motors; every motor is written for at least one firmware.
KITS = {
    "anaheim-bly172s": ("ti",),
    "beckhoff-am8051e": ("nxp",),
    "br2804-1700kv": ("simplefoc",),
    "brusa-hsm1": ("ti",),
    "estun-emj-04apb": ("ti",),
    "flipsky-6374": ("vesc", "moteus"),
    "gbm2804h-100t": ("simplefoc",),
    "hoverboard-hub": ("vesc", "odrive", "simplefoc"),
    "hurst-dma0204024b101": ("nxp",),
    "hurst-dmb0224c10002": ("ti",),
    "kollmorgen-akm44h": ("nxp",),
    "leadshine-el5-m0400": ("nxp",),
    "linix-45zwn24-40": ("nxp",),
    "mad-8318": ("moteus",),
    "mini-cheetah-motor": ("moteus",),
    "mjbots-mj5208": ("moteus",),
    "nanotec-db42m03": ("infineon",),
    "odrive-botwheel": ("odrive",),
    "odrive-d5065-270kv": ("odrive",),
    "odrive-d6374-150kv": ("odrive", "vesc"),
    "odrive-m8325s-100kv": ("odrive",),
    "scooter-hub-36v": ("st",),
    "shinano-la052": ("st",),
    "teknic-m2310p": ("ti", "nxp"),
    "tmotor-v2207-1500kv": ("simplefoc",),
    "toyota-prius-2004": ("infineon",),
}
OTHERS = ("vesc",)
MOTOR_NAMES = catalogue.motors()


def test_kits_are_of_motors_and_firmware_that_there_are() -> None:
    assert {*KITS} <= {*MOTOR_NAMES}
    assert {name for names in KITS.values() for name in names} == {*TARGETS}


@pytest.mark.slow
@pytest.mark.parametrize("name", MOTOR_NAMES)
def test_a_motor_is_tuned_and_written_for_its_firmware(name: str) -> None:
    design = catalogue.load(name)
    tuned = answer_tune(design)
    assert tuned.exit_code == 0
    assert tuned.tables
    answer = answer_export_for(design, KITS.get(name, OTHERS), None, verify=True)
    assert answer.files is not None
    assert answer.files.contents


@pytest.mark.thinned
@pytest.mark.parametrize("name", MOTOR_NAMES)
def test_a_motor_runs(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as end:
        cli.main(["run", name, "-o", "out"])
    printed = capsys.readouterr()
    assert (end.value.code, printed.err) == (0, "")
    assert "bit for bit" in printed.out
    assert (tmp_path / "out" / "report.html").is_file()
