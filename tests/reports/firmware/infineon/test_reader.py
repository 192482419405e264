"""Parameters of motor-ctrl-lib read: conversions, builds, damaged and hostile files."""

from __future__ import annotations

import math

import pytest

from dqforge.machines.errors import InputError
from dqforge.reports.firmware.infineon import read, recognise

# The numbers of the library's own defaults, in a layout of our own.
DEFAULTS = """void board(void)
{
    params.sys.samp.fs0 = 100.0E3;
    params.sys.samp.fpwm_fs0_ratio = 2U;
    params.sys.vdc_nom = 32.0f;
    params.sys.analog.calib.i_u = (CALIB_PARAMS_t){ 1.0f, 0.0f };
    params.sys.analog.filt.w0_i_ph = HZ_TO_RADSEC(ONE_OVER_TWO_PI * params.sys.samp.fs0);
}
void winding(void)
{
    params.motor.r = 11.0E-3f; // ohm
    params.motor.ld = 23.0E-6f;
    params.motor.lq = 28.0E-6f;
    params.motor.lam = 1.9E-3f;
    params.motor.P = 14.0f;
    params.motor.i_peak = 100.0f;
    params.motor.T_max = 1.8f;
    params.motor.v_nom = LINE_TO_PHASE(32.0f);
    params.motor.w_max.elec = MECH_TO_ELEC(HZ_TO_RADSEC(RPM_TO_HZ(1.5f * 12600)), params.motor.P);
    params.mech.inertia = 0.25f * POW_TWO(0.05f);
    params.mech.viscous = 7.0f * 0.0002f;
}
void loops(void)
{
#if defined(SIL_TEST)
    params.obs.pll.w0 = HZ_TO_RADSEC(500.0f);
#elif defined(REGRESSION_TEST)
    params.obs.pll.w0 = HZ_TO_RADSEC(1.5E3f);
#endif
    params.filt.spd_ar_wz[0] = HZ_TO_RADSEC(3.0E3f);
    params.filt.spd_ar_wp[0] = HZ_TO_RADSEC(10.0f);
    params.filt.spd_ar_en = En;
#if defined(CTRL_METHOD_SFO)
    params.ctrl.flux.bw = HZ_TO_RADSEC(400.0f);
#elif defined(CTRL_METHOD_TBC) || defined(CTRL_METHOD_RFO)
    params.ctrl.curr.ff_coef = 1.0f;
    params.ctrl.curr.bw = HZ_TO_RADSEC(1.5E3f);
#endif
    params.ctrl.speed.bw = HZ_TO_RADSEC(10.0f);
    params.obs.pll.kp = params.obs.pll.w0 / params.motor.lam;
    const float per_torque = 8.0f / (3.0f * params.motor.lam * POW_TWO(params.motor.P));
    const float times = 1.0f;
#if defined(CTRL_METHOD_TBC)
    params.ctrl.speed.kp = 9.0f;
#elif defined(CTRL_METHOD_RFO)
    params.ctrl.speed.kp = params.ctrl.speed.bw * params.mech.inertia * per_torque;
    params.ctrl.speed.ki = params.ctrl.speed.bw * params.mech.viscous *
        per_torque * times;
    params.ctrl.curr.kp.q = params.motor.lq * params.ctrl.curr.bw;
#endif
}
"""


def test_the_defaults_with_where_everything_stands() -> None:
    found = read(DEFAULTS, "ParamsDefault.c")
    drive = found.drive
    assert (drive.pole_pairs, drive.l_q, drive.l_d, drive.psi_pm) == (7, 28e-6, 23e-6, 1.9e-3)
    assert (drive.r_s, drive.i_max, drive.v_dc) == (11e-3, 100.0, 32.0)
    assert drive.omega_m_max == pytest.approx(12600.0 * 1.5 * math.pi / 30.0)
    assert drive.inertia == pytest.approx(6.25e-4)
    assert (drive.t_s, drive.f_sw) == (1e-5, 200e3)
    assert found.own["params.motor.v_nom"] == pytest.approx(32.0 / math.sqrt(3.0))
    assert found.own["params.sys.analog.filt.w0_i_ph"] == pytest.approx(100e3)
    assert "params.obs.pll.w0" not in found.own  # only in builds for tests
    assert "params.obs.pll.kp" not in found.own  # builds on it
    assert found.origins["r_s"].key == "params.motor.r"
    assert (found.origins["r_s"].text, found.origins["r_s"].line) == ("11.0E-3f", 11)
    assert found.origins["pole_pairs"].conversion == "twice the pole pairs"
    # At 12 % above what 32 V give, and a filter as slow as the speed loop.
    assert any("field weakening" in words for words in found.contradictions)
    assert any("spd_ar_en" in words for words in found.contradictions)


def test_gains_are_those_of_the_build_with_rotor_frame_orientation() -> None:
    found = read(DEFAULTS, "ParamsDefault.c")
    bandwidth = 2.0 * math.pi * 1500.0
    assert found.current_q is not None
    assert found.current_q.kp == pytest.approx(bandwidth * 28e-6)
    assert found.current_q.ki == pytest.approx(bandwidth * 11e-3)
    assert found.speed is not None
    constant = 1.5 * 7.0 * 1.9e-3
    assert found.speed.kp == pytest.approx(6.25e-4 * 2.0 * math.pi * 10.0 / constant)
    assert found.speed.ki == pytest.approx(1.4e-3 * 2.0 * math.pi * 10.0 / constant)


def test_pointers_to_the_structure_are_followed() -> None:
    text = "void f(T *m)\n{\n    m->params_ptr->motor.r = 0.5f;\n    params->motor.P = 4.0f;\n}\n"
    found = read(text, "a.c")
    assert found.drive.r_s == 0.5
    assert found.drive.pole_pairs == 2
    assert found.origins["r_s"].key == "m->params_ptr->motor.r"


def test_constants_of_another_header_are_left_out_in_words() -> None:
    text = DEFAULTS.replace(
        "params.motor.r", "params.sys.analog.shunt.res = CS_SHUNT_RES;\n    params.motor.r"
    )
    found = read(text, "ParamsDefault.c")
    assert "params.sys.analog.shunt.res" not in found.own
    assert found.drive.r_s == 0.011
    assert found.conventions[-1] == (
        "params.sys.analog.shunt.res is 'CS_SHUNT_RES', which this file does not define: omitted"
    )


TABLE = "static const float x_mtpa_flux_Wb[128] = {\n" + ", ".join(["0.5f"] * 127) + "%s\n};\n"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("int main(void) { return 0; }\n", "assigns no members of params.motor"),
        (DEFAULTS.replace("11.0E-3f", "eleven"), "params.motor.r is 'eleven'; write a number"),
        (DEFAULTS.replace("11.0E-3f", "11..3f"), "not a number"),
        (DEFAULTS.replace("14.0f", "14.5f"), "write a whole number"),
        (DEFAULTS.replace("= En", "= 1"), "write an enumerator"),
        (DEFAULTS.replace("#endif\n}\n", "}\n"), "#endif"),
        (DEFAULTS.replace("#if defined(SIL_TEST)", ""), "without #if"),
        (DEFAULTS.replace("// ohm", "/* ohm"), "comment"),
        (DEFAULTS.replace("11.0E-3f", "1.0f / 0.0f"), "not a number"),
        (DEFAULTS.replace("11.0E-3f", "(" * 100 + "1" + ")" * 100), "not a number"),
        (DEFAULTS.replace("11.0E-3f", "9" * 5000), "not a number"),
        (DEFAULTS + "#if A\n" * 100 + "#endif\n" * 100, "nested conditions"),
        (DEFAULTS + TABLE % "", "127 points; write 128"),
        (DEFAULTS + TABLE % ", x", "'x', not a number"),
    ],
)
def test_bad_files_are_refused_in_one_line(text: str, words: str) -> None:
    with pytest.raises(InputError) as refused:
        read(text, "bad.c")
    message = str(refused.value)
    assert message.startswith("bad.c")
    assert "\n" not in message
    assert words in message
    assert len(message) < 500


@pytest.mark.parametrize(
    "hostile",
    ["params.motor.r = " + "a" * 300_000, "params.motor." + "a." * 300_000 + "b = 1;"],
    ids=["word", "members"],
)
def test_what_is_long_is_read_once(hostile: str) -> None:
    with pytest.raises(InputError, match="assigns no members"):
        read(hostile, "hostile.c")


def test_what_is_of_others_is_not_recognised() -> None:
    assert recognise("ParamsDefault.c", DEFAULTS)
    assert not recognise("a.c", "params.kp = 3;\n")
    assert not recognise("a.json", DEFAULTS)
