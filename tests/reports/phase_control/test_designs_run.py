"""Designs of machines with any back-EMF as a stranger writes them: what `check` accepts runs or is
refused in one line with its place, and what it refuses is refused by `run` in the same words.
"""

from __future__ import annotations

import random
from pathlib import Path
from typing import Any, get_args

import pytest
import yaml

from dqforge import cli
from dqforge.machines.names import AxisGainRule, CurrentFrame, Feedforward, Topology
from dqforge.machines.topologies import TOPOLOGIES

CHOICES: dict[str, tuple[Any, ...]] = {
    "topology": get_args(Topology),
    "frame": (None, *get_args(CurrentFrame)),
    "feedforward": (None, *get_args(Feedforward)),
    "axis_gains": (None, *get_args(AxisGainRule)),
    "harmonic_integrators": (None, True, False),
    "limited_waveforms": (None, None, True, False),
    "control": (None, "float32", "q15", "q31", ["float32", "q15"]),
    "open_phase": (None, None, "a"),
    "simulation": (None, "averaged", "switched"),
    "opens": (False, False, True),
    "speed_loop": (False, True),
    "observer": (None, None, "reduced-order", "flux", "ekf"),
    "device": (False, True),
    "shape": ("equal", "trapezoid", "unequal"),
    "salient": (False, False, True),
    "frame_tables": (None, None, True),
    "bandwidth": ("300 Hz", "800 Hz"),
}

BRIEF: dict[str, Any] = {
    "frame": "table", "control": "float32", "limited_waveforms": None, "open_phase": None,
    "opens": False, "speed_loop": False, "observer": None, "device": False, "shape": "equal",
    "salient": False, "frame_tables": None, "bandwidth": "300 Hz", "simulation": "averaged",
    "feedforward": None, "axis_gains": None, "harmonic_integrators": None,
}  # fmt: skip

DEVICE = {
    "kind": "mosfet", "on_resistance": "40 mOhm", "turn_on_energy": "0.1 mJ",
    "turn_off_energy": "0.1 mJ", "reference_current": "20 A", "reference_voltage": "300 V",
    "thermal_resistance": "1 K/W",
}  # fmt: skip

TRAPEZOID = ((3, "21 %", "0 deg"), (5, "4 %", "0 deg"), (7, "2 %", "180 deg"))


def picked(seed: int, **fixed: Any) -> dict[str, Any]:
    """One choice of every key, by chance."""
    chance = random.Random(seed)
    return {key: chance.choice(values) for key, values in CHOICES.items()} | fixed


def machine(choice: dict[str, Any]) -> dict[str, Any]:
    first = {"order": 1, "amplitude": "0.2 Wb"}
    harmonics = [first, {"order": 3, "share": "12 %"}, {"order": 5, "share": "3 %"}]
    if choice["shape"] == "trapezoid":
        rest = [{"order": n, "share": share, "phase": phase} for n, share, phase in TRAPEZOID]
        harmonics = [first, *rest]
    made: dict[str, Any] = {
        "model": "waveform",
        "poles": 4,
        "resistance": "1 Ohm",
        "self_inductance": "7 mH",
        "mutual_inductance": "-1 mH",
        "back_emf": {"harmonics": harmonics},
        "max_current": "6 A",
        "max_speed": "1800 rpm",
        "inertia": "1.5e-3 kg m^2",
    }
    if choice["shape"] == "unequal":
        made["back_emf"] = {"file": "unequal.csv", "symmetric": False}
    if choice["salient"]:
        made["inductance_harmonics"] = [{"order": 2, "amplitude": "-1.2 mH"}]
    return made


def control(choice: dict[str, Any]) -> dict[str, Any]:
    keys = ("frame", "feedforward", "axis_gains", "harmonic_integrators", "limited_waveforms")
    loop = {"method": "bandwidth", "bandwidth": choice["bandwidth"]}
    made: dict[str, Any] = {
        "current_loop": loop | {key: choice[key] for key in keys if choice[key] is not None}
    }
    if choice["speed_loop"]:
        made["speed_loop"] = {"method": "symmetrical-optimum", "ratio": 10}
    if choice["observer"] is not None:
        made["observer"] = {"method": choice["observer"]}
        if choice["observer"] == "reduced-order":
            made["observer"]["pole"] = "500 rad/s"
    return made


def simulation(choice: dict[str, Any]) -> dict[str, Any]:
    made: dict[str, Any] = {
        "duration": "20 ms",
        "inverter": choice["simulation"],
        "shaft": {"points": [{"time": "0 s", "speed": "750 rpm"}]},
        "torque": {"points": [{"time": "0 s", "torque": "1 N m"}]},
    }
    if choice["opens"]:
        made["open_phase"] = {"phase": "b", "time": "10 ms"}
        if TOPOLOGIES[choice["topology"]].neutral:
            made["open_phase"]["detected_after"] = "1 ms"
    return made


def written(folder: Path, choice: dict[str, Any]) -> Path:
    """The design file of a choice, with the capture that it names."""
    rule = TOPOLOGIES[choice["topology"]]
    inverter: dict[str, Any] = {
        "topology": choice["topology"],
        "v_dc": "220 V",
        "switching_frequency": "10 kHz",
        "dead_time": "1 us",
    }
    inverter |= {"midpoint_capacitance": "4 mF"} if rule.midpoint else {}
    inverter |= {"device": DEVICE} if choice["device"] else {}
    named = ("control", "frame_tables")
    design: dict[str, Any] = {
        "dqforge": 1,
        "name": "Stranger",
        "machine": machine(choice),
        "inverter": inverter,
        "control": control(choice),
        "operation": {"strategy": "mtpa"},
        "waveform": {"torque": "1 N m", "speed": "750 rpm"},
        "export": {"prefix": "st", "vectors": 16}
        | {key: choice[key] for key in named if choice[key] is not None},
    }
    if choice["open_phase"] is not None:
        design["waveform"]["open_phase"] = choice["open_phase"]
    if choice["simulation"] is not None:
        design["simulation"] = simulation(choice)
    if choice["shape"] == "unequal":
        (folder / "unequal.csv").write_text(_unequal(), encoding="utf-8")
    path = folder / "design.yaml"
    path.write_text(yaml.safe_dump(design, sort_keys=False), encoding="utf-8")
    return path


def _unequal() -> str:
    """Flux linkages of three phases of which one is a quarter weaker, over the electrical angle."""
    import numpy as np

    theta = np.deg2rad(np.arange(360.0))
    turned = [theta - 2.0 * np.pi / 3.0 * k for k in range(3)]
    flux = [
        size * (np.cos(angle) + 0.03 * np.cos(5.0 * angle))
        for size, angle in zip((0.2, 0.15, 0.2), turned, strict=True)
    ]
    rows = [f"{k},{a:.8f},{b:.8f},{c:.8f}" for k, (a, b, c) in enumerate(zip(*flux, strict=True))]
    return "\n".join(["angle (deg),flux_a (Wb),flux_b (Wb),flux_c (Wb)", *rows, ""])


def asked(capsys: pytest.CaptureFixture[str], *words: str | Path) -> tuple[int, str]:
    """Exit code and what a command complains of."""
    with pytest.raises(SystemExit) as ended:
        cli.main([str(word) for word in words])
    return int(ended.value.code or 0), capsys.readouterr().err.strip()


def outcome(
    capsys: pytest.CaptureFixture[str], folder: Path, choice: dict[str, Any], *, verify: bool
) -> int:
    """Exit code of `run`, held against what `check` said."""
    path = written(folder, choice)
    checked, complaint = asked(capsys, "check", path)
    code, line = asked(
        capsys, "run", path, "-o", folder / "out", *(() if verify else ("--no-verify",))
    )
    if checked:
        assert (code, line) == (checked, complaint), choice
        assert checked in (1, 2)
    else:
        assert code in (0, 1), (choice, line)
    if code:
        assert "\n" not in line, choice
        assert "design.yaml:" in line, choice
        # A place, the key or section, what is wrong and what to write instead.
        assert line.count(": ") > 1, choice
    elif verify:
        assert asked(capsys, "verify", folder / "out")[0] == 0, choice
    return code


def test_the_choices_hold_every_name() -> None:
    """Two hundred designs meet every value of every key."""
    designs = [picked(seed) for seed in range(200)]
    for key, values in CHOICES.items():
        assert {str(found[key]) for found in designs} == {str(value) for value in values}


@pytest.mark.slow
def test_what_is_refused_is_refused_alike_by_check_and_run(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """Designs by chance; those that `check` accepts are left to the slow tests."""
    refused = 0
    for seed in range(12):
        path = written(tmp_path, picked(seed))
        code, complaint = asked(capsys, "check", path)
        if code:
            refused += 1
            again = asked(capsys, "run", path, "-o", tmp_path / "out", "--no-verify")
            assert again == (code, complaint)
            assert code in (1, 2)
            assert "design.yaml:" in complaint
            assert "write" in complaint or "remove" in complaint or "leave" in complaint, complaint
    assert 0 < refused < 12


@pytest.mark.slow
@pytest.mark.parametrize(
    ("topology", "changes"),
    [
        ("six-leg", {"control": "q15", "speed_loop": True}),
        ("split-capacitor", {"frame": "dqy", "opens": True, "simulation": "switched"}),
    ],
)
def test_a_design_without_any_base_or_gain_written_runs(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, topology: str, changes: dict[str, Any]
) -> None:
    """The voltage base holds what a phase reaches, so that fixed point needs no further key."""
    choice = BRIEF | {"topology": topology} | changes
    assert outcome(capsys, tmp_path, choice, verify=False) == 0


@pytest.mark.slow
@pytest.mark.parametrize("topology", get_args(Topology))
@pytest.mark.parametrize("seed", range(4))
def test_what_check_accepts_runs_and_verifies(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, topology: str, seed: int
) -> None:
    outcome(capsys, tmp_path, picked(1000 + seed, topology=topology), verify=True)


@pytest.mark.slow
@pytest.mark.parametrize("topology", get_args(Topology))
@pytest.mark.parametrize("number", ["float32", "q15"])
def test_every_topology_runs_and_verifies_in_every_number(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, topology: str, number: str
) -> None:
    choice = BRIEF | {"topology": topology, "control": number, "speed_loop": True}
    assert outcome(capsys, tmp_path, choice, verify=True) == 0
