"""MCAT's rules against its own files: every printed digit of every age."""

from __future__ import annotations

import csv
import math
from pathlib import Path

import nxp_published as published
import pytest

from dqforge.optimizer.firmware.mcat_numbers import (
    EDITIONS,
    FIXED_2022,
    FLOAT_2022,
    FLOAT_2025,
    constants,
    counts,
    held,
    printed,
    shift_of,
)

WHOLE = {
    "float of 2025": published.FLOAT_2025,
    "float of 2022": published.FLOAT_2022,
    "fixed point": published.FIXED_2022,
    "fixed point, speed loop by its rule": published.FIXED_AUTOMATIC,
    "speed gains by hand": published.HAND_TUNED,
    "high voltage, 70 %": published.HIGH_VOLTAGE,
    "servo of 2025, torque constant": published.SERVO_2025,
}


@pytest.mark.parametrize("data", WHOLE.values(), ids=WHOLE)
def test_every_printed_constant_follows_from_the_inputs(data: published.Published) -> None:
    made = constants(EDITIONS[data.version], data.inputs)
    wrong = {
        name: (text, made.get(f"M1_{name}"))
        for name, text in data.constants.items()
        if made.get(f"M1_{name}") != float(text)
    }
    assert not wrong


def test_what_the_comments_of_2019_tell_gives_twelve_places() -> None:
    data = published.COMMENTED_2019
    made = constants(EDITIONS["2019"], data.inputs)
    names = ("D_KP_GAIN", "D_KI_GAIN", "Q_KP_GAIN", "Q_KI_GAIN", "I_SCALE", "U_SCALE", "WI_SCALE")
    speed = ("SPEED_PI_PROP_GAIN", "SPEED_PI_INTEG_GAIN", "BEMF_DQ_KP_GAIN", "BEMF_DQ_KI_GAIN")
    for name in (*names, *speed, "TO_THETA_GAIN"):
        assert made[f"M1_{name}"] == float(data.constants[name]), name


def test_the_scales_of_2016_are_coarse_and_its_gains_whole() -> None:
    data = published.COMMENTED_FIXED
    inputs = data.inputs | {
        "parametersImax": 8.0,
        "parametersUdcbMax": 36.3,
        "parametersEmax": 15.1,
        "parametersNmax": 4400.0,
        "parametersNnom": 4000.0,
        "currentLoopF0": 280.0,
        "currentLoopKsi": 1.0,
        "currentLoopSampleTime": 1e-4,
        "sensorlessBemfObsrvF0": 300.0,
        "sensorlessBemfObsrvKsi": 1.0,
    }
    made = constants(EDITIONS[data.version], inputs)
    for name in ("U_MAX", "FREQ_MAX", "N_NOM", "I_SCALE", "U_SCALE", "E_SCALE", "WI_SCALE"):
        assert made[f"M1_{name}"] == float(data.constants[name]), name
    gains = ("D_KP_GAIN", "D_KI_GAIN", "Q_KP_GAIN", "Q_KI_GAIN")
    for name in (*gains, "BEMF_DQ_KP_GAIN", "BEMF_DQ_KI_GAIN"):
        assert made[f"M1_{name}"] == pytest.approx(float(data.constants[name]), rel=1e-14), name


NAMES = {
    "D_KP": "M1_D_KP_GAIN",
    "D_KI": "M1_D_KI_GAIN",
    "Q_KP": "M1_Q_KP_GAIN",
    "Q_KI": "M1_Q_KI_GAIN",
    "SPEED_KP": "M1_SPEED_PI_PROP_GAIN",
    "SPEED_KI": "M1_SPEED_PI_INTEG_GAIN",
    "I_SCALE": "M1_I_SCALE",
    "U_SCALE": "M1_U_SCALE",
    "WI_SCALE": "M1_WI_SCALE",
    "BEMF_KP": "M1_BEMF_DQ_KP_GAIN",
    "BEMF_KI": "M1_BEMF_DQ_KI_GAIN",
    "TO_KP": "M1_TO_KP_GAIN",
    "TO_KI": "M1_TO_KI_GAIN",
    "TO_THETA": "M1_TO_THETA_GAIN",
}


def _inputs(row: dict[str, str]) -> dict[str, float]:
    """Inputs of a pair; scales that the file of pairs leaves out do not enter its constants but
    for the speed scale of 4400 rpm and the EMF scale of 15.1 V, which all these projects have.
    """
    keys = {
        "parametersPP": "pole_pairs",
        "parametersRs": "Rs_ohm",
        "parametersLd": "Ld_H",
        "parametersLq": "Lq_H",
        "parametersKe": "Ke_vendor",
        "parametersKt": "Kt_Nm_A",
        "parametersJ": "J_kgm2",
        "parametersImax": "Imax_A",
        "parametersUdcbMax": "Udcmax_V",
        "currentLoopF0": "F0_current_Hz",
        "currentLoopKsi": "xi_current",
        "currentLoopSampleTime": "Ts_current_s",
        "speedLoopF0": "F0_speed_Hz",
        "speedLoopKsi": "xi_speed",
        "speedLoopSampleTime": "Ts_speed_s",
        "sensorlessBemfObsrvF0": "F0_bemf_Hz",
        "sensorlessTrackObsrvF0": "F0_track_Hz",
    }
    inputs = {key: float(row[column]) for key, column in keys.items() if row[column]}
    more = {"sensorlessBemfObsrvKsi": 1.0, "sensorlessTrackObsrvKsi": 1.0}
    if row["number_format"] != "float":
        more |= {"parametersNmax": 4400.0, "parametersEmax": 15.1}
        by_hand = float(row["speed_manual"] == "True")
        more |= {"speedLoopManualConstantTunning": by_hand}
        more |= {"speedLoopSLKp": 0.003, "speedLoopSLKi": 0.009}
    return inputs | more


def test_every_collected_pair_is_reproduced_to_the_printed_digits(shared_data: Path) -> None:
    path = shared_data / "vendor_gains" / "nxp_mcat_pairs.csv"
    with path.open(encoding="utf-8", newline="") as stream:
        rows = list(csv.DictReader(stream))
    wrong = []
    for row in rows:
        new = float(row["ki_disc_factor"]) == 0.5
        edition = FLOAT_2025 if new else FLOAT_2022
        if row["number_format"] != "float":
            edition = FIXED_2022
        made = constants(edition, _inputs(row))
        wrong += [
            (row["header"], column, row[column], made.get(macro))
            for column, macro in NAMES.items()
            if made.get(macro) is None or not math.isclose(made[macro], float(row[column]))
        ]
    assert len(rows) >= 19
    assert not wrong


def test_numbers_are_printed_as_a_script_of_the_tool_prints_them() -> None:
    assert printed(0.90716796875) == 0.907168
    assert printed(0.15) == 0.15
    assert printed(123456.789) == 123456.789
    assert printed(1.953125) == 1.95313
    assert printed(-2.0) == -2.0
    assert printed(0.0000049735919) == 0.00000497359


def test_integers_cut_off_toward_zero_and_stay_in_their_range() -> None:
    assert counts(0.000446804, "ACC32") == 14
    assert counts(-0.375, "FRAC16") == -12288
    assert counts(1.0, "FRAC16") == 32767
    assert held(0.119529, "FRAC32") == pytest.approx(0.119529, abs=2.0**-31)
    assert [shift_of(value) for value in (0.27, 0.0171, 0.96, 1.2, 2.7)] == [-1, -5, 0, 1, 2]
