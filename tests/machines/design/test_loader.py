"""Design files: what is read, converted and assumed, and what is refused where."""

from __future__ import annotations

import hashlib
import importlib.util
import math
from dataclasses import astuple
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from dqforge.machines.design import catalogue
from dqforge.machines.design.catalogue import load_design, load_text
from dqforge.machines.design.settings import CurrentLoopSettings, SpeedLoopSettings, Tolerances
from dqforge.machines.devices.inverter import SwitchDevice
from dqforge.machines.errors import InputError


def _corpus() -> ModuleType:
    path = Path(__file__).resolve().parents[2] / "broken_designs.py"
    spec = importlib.util.spec_from_file_location("broken_designs", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


CORPUS = _corpus()
BASE: str = CORPUS.BASE


def _bytes(content: str | bytes) -> bytes:
    return content if isinstance(content, bytes) else content.encode()


def _changed(*pairs: tuple[str, str]) -> bytes:
    text = BASE
    for old, new in pairs:
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    return text.encode()


@pytest.mark.thinned
@pytest.mark.parametrize(
    ("content", "line", "column", "phrase"),
    [pytest.param(*case[1:], id=case[0]) for case in CORPUS.BROKEN],
)
def test_broken_design_is_refused_in_one_helpful_line(
    content: str | bytes, line: int, column: int, phrase: str
) -> None:
    with pytest.raises(InputError) as caught:
        load_text(_bytes(content), "dir/drive.yaml")
    error = caught.value
    assert str(error).startswith(f"dir/drive.yaml:{line}:{column}: ")
    assert phrase in error.message
    assert str(error).isprintable()
    for word in ("Traceback", "pydantic", "type=", "validation error", "ctx", "NoneType"):
        assert word not in error.message
    assert error.exit_code == 2


def test_corpus_is_large_and_named_once() -> None:
    names = [case[0] for case in CORPUS.BROKEN]
    assert len(names) == len(set(names)) >= 45


def test_reads_a_design() -> None:
    design = load_text(BASE.encode(), "drive.yaml")
    assert design.name == "Bench motor"
    assert design.machine.pole_pairs == 3
    assert design.machine.r_s == 2.35
    assert (design.machine.l_d, design.machine.l_q) == (1.61e-3, 1.74e-3)
    assert design.machine.psi_pm == 0.06
    assert design.machine.i_max == design.i_max == 6.4
    assert design.machine.omega_m_max == pytest.approx(5420.0 * math.pi / 30.0, rel=1e-14)
    assert (design.inverter.v_dc, design.inverter.f_sw, design.inverter.dead_time) == (
        180.0,
        5000.0,
        2e-6,
    )
    assert design.inverter.device is None
    assert design.control.t_s == 2e-4
    assert design.control.current_loop.bandwidth == pytest.approx(400.0 * math.pi, rel=1e-14)
    assert design.control.speed_loop is not None
    assert design.control.speed_loop.ratio == 10
    assert design.control.observer is None
    assert design.strategy == "mtpa"
    assert (design.fit.degree, design.fit.segments, design.fit.torque_max) == (2, 2, None)
    assert design.losses is None
    assert (design.export.prefix, design.export.vectors) == ("bench", 64)
    assert design.digest == hashlib.sha256(BASE.encode()).hexdigest()


def test_default_bases() -> None:
    bases = load_text(BASE.encode(), "f").control.bases
    # Current limit, 180 V/sqrt(3), largest speed, 3/2 * 3 * 0.06 Wb * 6.4 A.
    assert bases.current == 6.4
    assert bases.voltage == pytest.approx(103.92304845413264, rel=1e-14)
    assert bases.speed == pytest.approx(5420.0 * math.pi / 30.0, rel=1e-14)
    # The magnets make 1.728 N m of it, the saliency of 8 % a little more.
    assert bases.torque == 1.73


def test_base_speed_without_largest_speed() -> None:
    # The back-EMF 3 * 0.06 * omega reaches 180 V/sqrt(3) at 577.35 rad/s.
    without = load_text(_changed(("  max_speed: 5420 rpm\n", "")), "f")
    assert without.control.bases.speed == pytest.approx(577.3502691896257, rel=1e-14)
    rated = load_text(_changed(("max_speed: 5420 rpm", "rated: {speed: 3000 rpm}")), "f")
    assert rated.control.bases.speed == pytest.approx(100.0 * math.pi, rel=1e-14)


def test_given_bases() -> None:
    text = (
        "  per_unit: {current: {value: 4 A, kind: rms}, voltage: 100 V, speed: 6000 rpm, torque: 2 "
        "N m}\noperation:"
    )
    design = load_text(_changed(("operation:", text)), "f")
    bases = design.control.bases
    assert bases.current == pytest.approx(5.656854249492381, rel=1e-14)
    assert (bases.voltage, bases.torque) == (100.0, 2.0)
    assert bases.speed == pytest.approx(200.0 * math.pi, rel=1e-14)
    assert not [sentence for sentence in design.assumptions if "per_unit" in sentence]


def test_reluctance_machine() -> None:
    text = _changed(("0.06 Wb", "0 Wb"), ("1.74 mH", "12 mH"), ("torque-exact", "closed-form"))
    design = load_text(text, "f")
    assert design.machine.psi_pm == 0.0
    # 3/2 p (L_q - L_d) i^2 / 2 at 45 degrees: 0.9575 N m of a current of 6.4 A.
    assert 0.9575 < 0.75 * 3 * (12.0e-3 - 1.61e-3) * 6.4**2 < design.control.bases.torque == 0.958
    assert any("largest torque at the base current" in note for note in design.assumptions)


def test_the_base_torque_that_is_not_given_holds_every_reference_of_the_library() -> None:
    """A salient or saturated machine makes more than its magnets do."""
    for name in [*catalogue.names(), *catalogue.motors()]:
        design = catalogue.load(name)
        if any("control.per_unit.torque is inferred" in note for note in design.assumptions):
            continue
        machine, bases = design.machine, design.control.bases
        angle = np.linspace(0.0, 1.0, 5001) * np.pi
        i_d, i_q = bases.current * np.cos(angle), bases.current * np.sin(angle)
        made = machine.torque(i_d, i_q)
        assert np.nanmax(made) <= bases.torque * (1.0 + 1e-9), name
        assert bases.torque <= 1.02 * max(
            np.nanmax(made), machine.torque_per_ampere * bases.current
        )


def test_terminal_values_are_halved_and_noted() -> None:
    design = load_text(
        _changed(
            (
                "resistance: 2.35 Ohm",
                "resistance: {value: 4.7 Ohm, kind: line-to-line, source: page 3}",
            ),
            ("inductance_d: 1.61 mH", "inductance_d: {value: 3.22 mH, kind: line-to-line}"),
        ),
        "f",
    )
    assert design.machine.r_s == 2.35
    assert design.machine.l_d == 1.61e-3
    value = next(v for v in design.values if v.path == "machine.resistance")
    assert (value.text, value.si, value.unit, value.source) == (
        "4.7 Ohm (line-to-line)",
        2.35,
        "Ohm",
        "page 3",
    )
    assert "half of the line-to-line value" in value.note
    assert not [sentence for sentence in design.assumptions if "machine.resistance" in sentence]
    assert [
        sentence
        for sentence in design.assumptions
        if "machine.inductance_q is taken as a phase" in sentence
    ]


def test_poles_and_rms_current() -> None:
    design = load_text(
        _changed(("pole_pairs: 3", "poles: 6"), ("6.4 A", "{value: 5 A, kind: rms}")), "f"
    )
    assert design.machine.pole_pairs == 3
    assert design.machine.i_max == pytest.approx(7.0710678118654755, rel=1e-14)


def test_current_limit_is_the_smaller_one() -> None:
    design = load_text(
        _changed(("  dead_time", "  max_current: {value: 4 A, kind: rms}\n  dead_time")), "f"
    )
    assert design.inverter.i_max == pytest.approx(5.656854249492381, rel=1e-14)
    assert design.i_max == design.control.bases.current == design.inverter.i_max


@pytest.mark.parametrize(
    ("lines", "key"),
    [
        # 0.06 Wb and 3 pole pairs: 23.0859 V/krpm between terminals, r.m.s.;
        # its reciprocal as rpm per volt peak.
        (
            "back_emf_constant: {value: 23.085916 V/krpm, kind: line-to-line rms}",
            "back_emf_constant",
        ),
        ("back_emf_constant: {value: 30.6294 rpm/V, kind: line-to-line peak}", "back_emf_constant"),
        ("torque_constant: {value: 0.27 N m/A, kind: peak}", "torque_constant"),
        ("torque_constant: {value: 0.38183766 N m/A, kind: rms}", "torque_constant"),
    ],
)
def test_flux_from_other_constants(lines: str, key: str) -> None:
    design = load_text(_changed(("magnet_flux: 0.06 Wb", lines)), "f")
    assert design.machine.psi_pm == pytest.approx(0.06, rel=2e-5)
    derived = next(v for v in design.values if v.path == "machine.magnet_flux")
    assert derived.si == design.machine.psi_pm
    assert f"derived from {key}" in derived.note
    assert any(f"derived from {key}" in sentence for sentence in design.assumptions)
    assert (
        "implies a magnet flux of"
        in next(v for v in design.values if v.path == f"machine.{key}").note
    )


def test_back_emf_has_precedence_over_torque_constant() -> None:
    lines = (
        "torque_constant: {value: 0.28 N m/A, kind: peak}\n"
        "  back_emf_constant: {value: 0.18 V s/rad, kind: phase peak}"
    )
    assert load_text(
        _changed(("magnet_flux: 0.06 Wb", lines)), "f"
    ).machine.psi_pm == pytest.approx(0.06)


def test_contradiction_points_to_the_later_key() -> None:
    lines = "torque_constant: {value: 0.54 N m/A, kind: peak}\n  magnet_flux: 0.06 Wb"
    with pytest.raises(InputError) as caught:
        load_text(_changed(("magnet_flux: 0.06 Wb", lines)), "f")
    assert (caught.value.line, caught.value.column) == (10, 16)


def test_power_invariant_flux() -> None:
    # 0.06 Wb times sqrt(3/2).
    design = load_text(
        _changed(("0.06 Wb", "{value: 0.0734846923 Wb, kind: power-invariant}")), "f"
    )
    assert design.machine.psi_pm == pytest.approx(0.06, rel=1e-9)


def test_assumptions_name_the_defaults() -> None:
    text = BASE.partition("control:\n")[0].replace(
        "  inertia: 200e-6 kg m^2\n", "  inertia: {value: 1, inferred: true}\n"
    )
    sentences = load_text(text.encode(), "f").assumptions
    for start in (
        (
            "machine.resistance is taken as a phase value; write kind: line-to-line if it was "
            "measured between two"
        ),
        "machine.magnet_flux is taken as a peak value; write kind: rms",
        "machine.max_current is taken as a peak value; write kind: rms",
        "machine.inertia is inferred: no reason is given",
        "control.sampling_frequency is taken as the switching frequency, 5 kHz",
        "control.per_unit.current is 6.4 A: the current limit",
        "control.per_unit.torque is 1.73 N m: the largest torque at the base current, rounded up",
        "operation.strategy is mtpa",
        "fit.max_torque is the largest torque within the current limit",
        "export.prefix is motor",
    ):
        assert any(sentence.startswith(start) for sentence in sentences), start


def test_warnings_at_the_largest_speed() -> None:
    sentences = load_text(_changed(("5420 rpm", "12000 rpm")), "f").assumptions
    # sqrt(3) * 3 * 1256.6 * 0.06 = 391.8 V; 600 Hz electrical against 5 kHz sampling.
    assert any("391.78 V, above v_dc = 180 V" in sentence for sentence in sentences)
    assert any("8.3 samples per electrical period" in sentence for sentence in sentences)


def test_device_losses_and_observer() -> None:
    device = """\
  coolant_temperature: 0 degC
  device:
    kind: igbt
    on_resistance: 7 mOhm
    on_resistance_temperature_coefficient: 0.3 %/K
    on_voltage: 1 V
    diode_voltage: 0.9 V
    diode_resistance: 5 mOhm
    turn_on_energy: 6 mJ
    turn_off_energy: 5 mJ
    reverse_recovery_energy: 2 mJ
    reference_current: 150 A
    reference_voltage: 300 V
    thermal_resistance: 0.4 K/W
control:
"""
    losses = "losses: {points: [{torque: -1 N m, speed: 1200 rpm}], strategies: [mtpa]}\nexport:"
    text = _changed(
        ("control:\n", device),
        ("operation:", "  observer: {pole: 100 Hz}\noperation:"),
        ("export:", losses),
    )
    design = load_text(text, "f")
    assert design.inverter.device == SwitchDevice(
        kind="igbt",
        on_resistance=7e-3,
        turn_on_energy=6e-3,
        turn_off_energy=5e-3,
        reference_current=150.0,
        reference_voltage=300.0,
        thermal_resistance=0.4,
        reverse_recovery_energy=2e-3,
        on_resistance_temperature_coefficient=3e-3,
        on_voltage=1.0,
        diode_voltage=0.9,
        diode_resistance=5e-3,
    )
    assert design.inverter.coolant_temperature == 0.0
    assert design.control.observer is not None
    assert design.control.observer.pole == pytest.approx(200.0 * math.pi, rel=1e-14)
    assert design.control.observer.method == "reduced-order"
    assert design.losses is not None
    assert design.losses.points[0].torque == -1.0
    assert design.losses.points[0].omega_m == pytest.approx(40.0 * math.pi, rel=1e-14)
    assert design.losses.strategies == ("mtpa",)
    assert design.losses.modulations == ("spwm", "svpwm", "ddt-gdpwm")


def test_given_gains_and_margin() -> None:
    text = _changed(
        (
            "    method: bandwidth\n    bandwidth: 200 Hz",
            (
                "    method: given\n    kp: 1.1 V/A\n    ki: 32 V/(A s)\n    q_formats: [10, 15]\n"
                "    min_phase_margin: 0"
            ),
        ),
        (
            "method: symmetrical-optimum",
            "method: given\n    kp: 0.1 N m/(rad/s)\n    ki: 6 N m/rad\n    filter_time: 1 ms",
        ),
    )
    control = load_text(text, "f").control
    assert (control.current_loop.kp, control.current_loop.ki) == (1.1, 32.0)
    assert control.current_loop.min_phase_margin == 0.0
    assert control.current_loop.q_formats == (10, 15)
    assert control.speed_loop is not None
    assert (control.speed_loop.kp, control.speed_loop.ki, control.speed_loop.filter_time) == (
        0.1,
        6.0,
        1e-3,
    )
    assert control.speed_loop.min_phase_margin == pytest.approx(math.pi / 6.0)


def test_breakpoints() -> None:
    text = _changed(
        ("  segments: 2", "  segments: 3\n  max_torque: 1.5 N m\n  breakpoints: [0.5 N m, 1]")
    )
    fit = load_text(text, "f").fit
    assert fit.torque_max == 1.5
    assert fit.breakpoints == (0.5, 1.0)


def test_first_fault_in_the_file_is_reported() -> None:
    text = _changed(("1.61 mH", "x"), ("180 V", "y"), ("prefix: bench", "prefix: 1"))
    with pytest.raises(InputError) as caught:
        load_text(text, "f")
    assert caught.value.line == 7


def test_rated_values_that_agree() -> None:
    rated = """inertia: 200e-6 kg m^2
  rated: {torque: 0.47 N m, speed: 5420 rpm, power: 267 W, current: {value: 1.6 A, kind: rms}, frequency: 271 Hz}"""
    design = load_text(_changed(("inertia: 200e-6 kg m^2", rated)), "f")
    current = next(v for v in design.values if v.path == "machine.rated.current")
    assert current.si == pytest.approx(2.262741699796952)


def test_load_design_reads_a_file_and_names_it_as_given(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("drive.yaml").write_bytes(BASE.encode())
    assert (
        load_design("drive.yaml")
        == load_design(Path("drive.yaml"))
        == load_text(BASE.encode(), "drive.yaml")
    )
    Path("drive.yaml").write_bytes(BASE.replace("180 V", "180 A").encode())
    with pytest.raises(InputError, match=r"^drive\.yaml:14:9: inverter\.v_dc: expected a voltage"):
        load_design("drive.yaml")


# What a slip of the keyboard or a wrong idea of the format may leave in place of any value.
SLIPS = [
    "",
    "x",
    "1",
    "-1",
    "0",
    "1e30",
    "1e-30",
    "true",
    "[]",
    "{}",
    "[1, 2]",
    "{value: 1}",
    "'5'",
    "1 V",
    "5 kHz",
    "~",
]


@pytest.mark.thinned
@pytest.mark.parametrize("slip", SLIPS)
def test_any_wrong_value_is_read_or_refused(slip: str) -> None:
    design = catalogue.template().decode().splitlines()
    for number, line in enumerate(design):
        key, colon, value = line.partition(": ")
        if not colon or line.lstrip().startswith(("#", "-")) or not value.strip():
            continue
        text = "\n".join([*design[:number], f"{key}: {slip}", *design[number + 1 :]])
        try:
            load_text(text.encode(), "f")
        except InputError as error:
            message = error
        else:
            continue
        assert str(message).isprintable()
        assert message.line is not None


def test_same_bytes_same_design() -> None:
    assert load_text(BASE.encode(), "a") == load_text(BASE.encode(), "b")


def test_each_setting_of_the_speed_loop_reaches_its_own_field() -> None:
    text = _changed(
        (
            "    method: symmetrical-optimum\n    ratio: 10\n",
            (
                "    method: damping\n    ratio: 4\n    bandwidth: 20 rad/s\n    damping: 0.8\n"
                "    spread: 2.5\n"
                "    filter_time: 3 ms\n    min_phase_margin: 0.4 rad\n    q_formats: [9, 14]\n"
            ),
        )
    )
    assert load_text(text, "drive.yaml").control.speed_loop == SpeedLoopSettings(
        method="damping",
        ratio=4,
        bandwidth=20.0,
        damping=0.8,
        spread=2.5,
        filter_time=3e-3,
        min_phase_margin=0.4,
        q_formats=(9, 14),
    )


def test_each_setting_of_the_current_loop_reaches_its_own_field() -> None:
    text = _changed(
        (
            "    method: bandwidth\n    bandwidth: 200 Hz\n",
            (
                "    method: given\n    kp: 1.5 V/A\n    ki: 32 V/(A s)\n    damping: 0.9\n"
                "    spread: 3.5\n"
                "    min_phase_margin: 0.4 rad\n    q_formats: [9, 14]\n"
            ),
        )
    )
    assert load_text(text, "drive.yaml").control.current_loop == CurrentLoopSettings(
        method="given",
        kp=1.5,
        ki=32.0,
        damping=0.9,
        spread=3.5,
        min_phase_margin=0.4,
        q_formats=(9, 14),
    )


def test_tolerances_reach_their_own_fields() -> None:
    lines = (
        "r_s: 30 %, l_d: 20 %, l_q: 0.25, psi_pm: 5 %, inertia: 40 %, v_dc: 10 %, dead_time: 15 %"
    )
    loop = "    ratio: 10\n"
    text = _changed(
        (loop, f"{loop}  tolerances: {{{lines}, low_current: {{value: 1 A, kind: rms}}}}\n")
    )
    found = load_text(text, "drive.yaml").control.tolerances
    assert found is not None
    expected = Tolerances(0.3, 0.2, 0.25, 0.05, 0.4, 0.1, 0.15 * 2e-6, math.sqrt(2.0))
    np.testing.assert_allclose(astuple(found), astuple(expected), rtol=1e-12)

    text = _changed((loop, f"{loop}  tolerances: {{dead_time: 0.3 us}}\n"))
    loaded = load_text(text, "drive.yaml")
    assert loaded.control.tolerances is not None
    np.testing.assert_allclose(
        astuple(loaded.control.tolerances), astuple(Tolerances(dead_time=3e-7, low_current=0.64))
    )
    assert any("low_current is 640 mA peak" in sentence for sentence in loaded.assumptions)
    assert load_text(_changed(), "drive.yaml").control.tolerances is None


def test_optimised_loops_and_their_bounds_are_read() -> None:
    text = _changed(
        (
            "    method: bandwidth\n    bandwidth: 200 Hz\n",
            "    method: optimised\n    max_sensitivity: 1.4\n",
        ),
        ("    method: symmetrical-optimum\n", "    method: optimised\n    max_sensitivity: 2\n"),
    )
    control = load_text(text, "drive.yaml").control
    assert (control.current_loop.method, control.current_loop.max_sensitivity) == ("optimised", 1.4)
    assert control.speed_loop is not None
    assert (control.speed_loop.method, control.speed_loop.max_sensitivity) == ("optimised", 2.0)


@pytest.mark.parametrize(
    ("sampling", "belongs"), [("500 Hz", True), ("499 Hz", False), ("10 kHz", True)]
)
def test_sampling_belongs_to_the_switching_from_a_tenth_to_twice_its_frequency(
    sampling: str, *, belongs: bool
) -> None:
    text = _changed(("sampling_frequency: 5 kHz", f"sampling_frequency: {sampling}"))
    if belongs:
        assert load_text(text, "drive.yaml").control.t_s in (2e-3, 1e-4)
    else:
        with pytest.raises(InputError, match="does not belong to a switching frequency"):
            load_text(text, "drive.yaml")
