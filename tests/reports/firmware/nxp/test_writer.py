"""Headers of MCAT written: round trips, existing files, MCAT's own acceptance, a compiler."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import nxp_published as published
import pytest
from nxp_designs import asked_for, design_of
from nxp_headers import header

from dqforge.machines.errors import InputError
from dqforge.optimizer.firmware.configuration import Configuration, PiGains
from dqforge.optimizer.firmware.firmware_method import Asked
from dqforge.optimizer.firmware.mcat_numbers import FIXED_2022, FLOAT_2025, Edition
from dqforge.optimizer.firmware.targets.nxp import NXP, configured
from dqforge.reports.firmware.nxp import constant_text, plain, read, write
from dqforge.reports.firmware.target import FileTitle

TITLE = FileTitle("hub", "hub motor", "0" * 64, "0.0.0", ("a remark",))

NAME = "m1_pmsm_appconfig.h"

GCC = shutil.which("gcc")


def _text(found: Configuration, existing: str | None = None) -> str:
    files = write(found, TITLE, existing)
    assert len(files) == 1
    return next(iter(files.values())).decode("ascii")


def _same(first: Configuration, second: Configuration) -> bool:
    return replace(first, origins={}) == replace(second, origins={})


def _named(asked: Asked, name: str) -> Asked:
    return replace(asked, design=replace(asked.design, name=name))


def _random_asked(asked: Asked, rng: np.random.Generator) -> Asked:
    """Another machine on the same inverter, with gains of poles that it can have."""
    l_d, l_q, r_s = (float(10.0**power) for power in rng.uniform((-5, -5, -2.5), (-2, -2, 1)))
    psi, inertia = (float(10.0**power) for power in rng.uniform((-3, -6), (0, -1)))
    drive = replace(
        asked.drive,
        pole_pairs=int(rng.integers(1, 30)),
        r_s=r_s,
        l_d=l_d,
        l_q=l_q,
        psi_pm=psi,
        inertia=None if rng.random() < 0.1 else inertia,
        omega_m_max=float(rng.uniform(20.0, 3000.0)),
        t_s=float(rng.choice([2e-5, 5e-5, 6.25e-5, 1e-4])),
        t_speed=float(rng.choice([5e-4, 1e-3])),
    )
    rate = float(rng.uniform(500.0, 5000.0)) + r_s / min(l_d, l_q)
    slow = float(rng.uniform(5.0, 100.0))
    return replace(
        asked,
        drive=drive,
        current_d=PiGains(rate * l_d, rate * r_s),
        current_q=PiGains(rate * l_q, rate * r_s),
        speed=PiGains(slow * inertia / psi, slow * slow * inertia / psi),
    )


@pytest.mark.parametrize("count", [40, pytest.param(200, marks=pytest.mark.slow)])
def test_random_machines_come_back_as_they_went(tmp_path: Path, count: int) -> None:
    asked = asked_for(design_of(tmp_path))
    rng = np.random.default_rng(17)
    for number in range(count):
        found = NXP.configure(_random_asked(asked, rng))
        back = read(_text(found), NAME)
        assert _same(back, found), number


@pytest.mark.slow
def test_fixed_point_comes_back_too_where_it_fits(tmp_path: Path) -> None:
    asked = asked_for(design_of(tmp_path, loop="q_formats: auto"))
    rng = np.random.default_rng(18)
    fitting, refused = 0, []
    for number in range(200):
        try:
            found = configured(_random_asked(asked, rng), FIXED_2022)
        except InputError as error:
            refused.append(str(error))
            continue
        fitting += 1
        assert _same(read(_text(found), NAME), found), number
    assert fitting > 50
    assert all("holds no more than" in words for words in refused)


def test_a_second_write_into_its_own_file_changes_nothing(tmp_path: Path) -> None:
    found = NXP.configure(asked_for(design_of(tmp_path)))
    text = _text(found)
    assert _text(found, text) == text


def test_what_others_wrote_into_the_file_stays(tmp_path: Path) -> None:
    found = NXP.configure(asked_for(design_of(tmp_path)))
    existing = header(published.FLOAT_2025).replace(
        "#define AA 1", "#define AA 1\n#define MINE (7.5F) /* of the user */"
    )
    text = _text(found, existing)
    assert "#define MINE (7.5F) /* of the user */" in text
    assert "#define M1_POSPE_ENC_PULSES (1000)" in text
    assert '"motorName": "Linix"' in text
    back = read(text, NAME)
    assert back.current_q == found.current_q
    assert back.drive == found.drive
    for key in ("parametersRs", "currentLoopF0", "M1_SPEED_PI_PROP_GAIN"):
        assert back.own[key] == found.own[key]
    # The published header lacks the start current: it stands before the user's block.
    assert "#define M1_OL_START_I (16.9706F)\n/* USER INPUT START */" in text
    assert text.count("\n") == existing.count("\n") + 1


def test_scales_and_thresholds_of_the_board_stay(tmp_path: Path) -> None:
    found = NXP.configure(asked_for(design_of(tmp_path)))
    existing = header(published.FLOAT_2025)
    theirs, text = read(existing, NAME), _text(found, existing)
    back = read(text, NAME)
    for key in ("parametersImax", "M1_I_MAX", "M1_U_DCB_MAX"):
        assert back.own[key] == theirs.own[key] != found.own[key], key
    # The link of the design is a fault on this board: its thresholds are the design's.
    assert back.own["parametersUdcbOver"] == found.own["parametersUdcbOver"]
    assert back.current_q == found.current_q


def test_a_new_torque_constant_stands_where_the_file_has_its_key(tmp_path: Path) -> None:
    found = NXP.configure(asked_for(design_of(tmp_path)))
    existing = header(published.FLOAT_2025).replace('"parametersKe"', '"parametersKt"')
    back = read(_text(found, existing), NAME)
    assert "parametersKe" not in back.own
    assert back.drive.psi_pm == found.drive.psi_pm


def test_a_file_of_2022_keeps_its_age_and_runs_the_same_loops(tmp_path: Path) -> None:
    found = NXP.configure(asked_for(design_of(tmp_path)))
    text = _text(found, header(published.FLOAT_2022))
    back = read(text, NAME)
    assert back.version == "2022"
    assert back.current_q is not None
    assert found.current_q is not None
    assert back.current_q.ki == pytest.approx(found.current_q.ki, rel=1e-5)
    assert back.speed is not None
    assert found.speed is not None
    assert back.speed.ki == pytest.approx(found.speed.ki, rel=1e-5)
    assert back.own["M1_SPEED_IIR_B0"] == found.own["M1_SPEED_IIR_B0"]


def test_line_comments_of_2019_are_changed_where_they_stand(tmp_path: Path) -> None:
    found = NXP.configure(asked_for(design_of(tmp_path)))
    existing = header(published.COMMENTED_2019)
    text = _text(found, existing)
    back = read(text, NAME)
    assert back.version == "2019"
    assert back.drive.r_s == found.drive.r_s
    assert back.current_q is not None
    assert found.current_q is not None
    assert back.current_q.kp == pytest.approx(found.current_q.kp, rel=1e-9)
    assert "//Stator resistance                     = 0.05 [Ohms]" in text


def test_the_second_motor_keeps_its_prefix(tmp_path: Path) -> None:
    found = NXP.configure(asked_for(design_of(tmp_path)))
    existing = header(published.FLOAT_2025, motor=2)
    files = write(found, TITLE, existing)
    assert list(files) == ["m2_pmsm_appconfig.h"]
    text = files["m2_pmsm_appconfig.h"].decode("ascii")
    assert "#define M2_D_KP_GAIN (0.628319F)" in text
    assert "M1_" not in text


def test_the_other_arithmetic_is_refused(tmp_path: Path) -> None:
    found = NXP.configure(asked_for(design_of(tmp_path)))
    with pytest.raises(InputError, match="not one of a float build"):
        write(found, TITLE, header(published.FIXED_2022))


def _as_mcat_takes_it(text: str) -> dict[str, object]:
    """The steps of the reader inside MCAT: comments by the lines that begin and end them."""
    lines = text.split("\n")
    starts = [k for k, line in enumerate(lines) if line.startswith("/*")]
    ends = [k for k, line in enumerate(lines) if line.startswith("*/")]
    licence = "\n".join(lines[starts[0] : ends[0] + 1])
    assert "License" in licence
    assert "Copyright" in licence
    assert lines[starts[1] : ends[1] + 1]
    values = json.loads("\n".join(lines[starts[2] + 1 : ends[2]]))
    motor = json.loads("\n".join(lines[starts[3] + 1 : ends[3]]))
    assert {"motorName", "motorDescription"} <= set(motor)
    user = "\n".join(lines[starts[-2] : starts[-1] + 1])
    assert "/* USER INPUT START */" in user
    assert "/* USER INPUT END */" in user
    known = {"parameters", "speedLoop", "positionLoop", "currentLoop", "sensors", "sensorless"}
    assert set(values) <= known
    assert len(known - set(values)) <= 1
    numbers = [value for held in values.values() for value in held.values()]
    assert all(isinstance(value, bool | int | float) for value in numbers)
    assert isinstance(values, dict)
    return values


@pytest.mark.parametrize("edition", [FLOAT_2025, FIXED_2022])
def test_mcat_itself_would_load_the_file(tmp_path: Path, edition: Edition) -> None:
    asked = _named(asked_for(design_of(tmp_path)), '*/ a name /* " with all')
    values = _as_mcat_takes_it(_text(configured(asked, edition)))
    held = values["parameters"]
    assert isinstance(held, dict)
    assert held["parametersRs"] == 0.05


def test_the_name_of_the_motor_comes_back_whatever_is_in_it(tmp_path: Path) -> None:
    asked = _named(asked_for(design_of(tmp_path)), "*/ a name /* of µ")
    found = NXP.configure(asked)
    text = _text(found)
    assert read(text, NAME).name == "*/ a name /* of µ"


def test_no_date_and_no_path_stand_in_the_file(tmp_path: Path) -> None:
    text = _text(NXP.configure(asked_for(design_of(tmp_path))))
    assert str(tmp_path) not in text
    assert not re.search(r"\b20[0-9]{2}-[0-9]{2}|DATE", text)


STUB = """
typedef short frac16_t; typedef int frac32_t; typedef int acc32_t;
#define FRAC16(x) ((frac16_t)((x) < 0.999969482421875 ? (x) * 0x8000 : 0x7FFF))
#define FRAC32(x) ((frac32_t)((x) < 0.9999999995343387 ? (x) * 0x80000000 : 0x7FFFFFFF))
#define ACC32(x) ((acc32_t)((x) * 0x8000))
"""


@pytest.mark.skipif(GCC is None, reason="no gcc")
@pytest.mark.parametrize("edition", [FLOAT_2025, FIXED_2022])
def test_every_macro_compiles_as_a_number(tmp_path: Path, edition: Edition) -> None:
    asked = asked_for(design_of(tmp_path, name='"a \\\\ name?"'))
    text = _text(configured(asked, edition))
    (tmp_path / NAME).write_text(text, encoding="ascii")
    names = re.findall(r"^#define (M1_\w+) ", text, re.MULTILINE)
    assert len(names) > 60
    uses = "\n".join(f"volatile double v{k} = (double)({name});" for k, name in enumerate(names))
    source = tmp_path / "use.c"
    source.write_text(f'{STUB}#include "{NAME}"\n{uses}\n', encoding="ascii")
    flags = ["-std=c11", "-Wall", "-Wextra", "-Werror", "-fsyntax-only"]
    done = subprocess.run(
        [str(GCC), *flags, str(source)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr


def test_numbers_stand_as_mcat_writes_them() -> None:
    assert constant_text(2.0, "float", commented=False) == "(2.0F)"
    assert constant_text(0.000028607509, "float", commented=False) == "(0.0000286075F)"
    assert constant_text(0.9, "FRAC16", commented=False) == "FRAC16(0.9)"
    assert constant_text(6400.0, "plain", commented=False) == "(6400)"
    assert constant_text(0.908503238985, "float", commented=True) == "(0.908503238985F)"
    assert plain(1.6e-6) == "0.0000016"
    assert plain(value=True) == "true"
