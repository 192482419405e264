"""Rows of studies: how often each step is computed, how rows end, and that nothing depends on how
they are cut into blocks.
"""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from study_trials import MACHINES, POINTS, Rows, loop_names, outputs, plan_of

from dqforge.machines.errors import InputError
from dqforge.optimizer.exploration import block_rows
from dqforge.optimizer.exploration.study_plan import SINGLE_BATCH, TOGETHER_BATCH, YIELD_BATCH

_DEVICES = (
    "{name: fuji-2mbi300xbe120-50}, {name: infineon-ff200r12ke3}, {name: mitsubishi-cm200dy-24t}, "
    "{name: sirectifier-sii400s12}, {name: microchip-mscsm70am10ct3ag}, "
    "{name: wolfspeed-c2m0045170d}, {name: ti-csd19505ktt}"
)

_EXAMPLE = f"""vary:
  inverter.device: {{values: [{_DEVICES}]}}
  inverter.switching_frequency: {{range: {{from: 8 kHz, to: 100 kHz, count: 20, spacing: log}}}}
  losses.modulations: {{values: all, one_by_one: true}}
set:
  control.sampling_frequency: 16 kHz
  losses.points:
    - {{torque: 40 N m, speed: 450 rad/s, weight: 60 %}}
    - {{torque: 130 N m, speed: 300 rad/s, weight: 30 %}}
    - {{torque: 180 N m, speed: 200 rad/s, weight: 10 %}}
limits: {{losses.ripple_current: 6 A, losses.junction_temperature: 150 degC}}
pareto: {{minimise: [losses.total, losses.ripple_current]}}
"""


@pytest.fixture(scope="module")
def modules() -> Rows:
    """Seven modules, twenty frequencies, every modulator."""
    return Rows.of(plan_of(_EXAMPLE))


def test_rows_that_differ_in_device_alone_fit_once(modules: Rows) -> None:
    work = modules.plan.work
    assert modules.plan.count == 1680
    assert (work.fits, work.gain_sets, work.limits) == (1, 1, 1)
    assert work.budget_calls == 6  # the seventh device is refused by its design
    assert modules.plan.batch == TOGETHER_BATCH


@pytest.mark.parametrize(
    ("device", "watts", "allowed"),
    [
        ("sirectifier-sii400s12", 578, 124),
        ("fuji-2mbi300xbe120-50", 597, 160),
        ("mitsubishi-cm200dy-24t", 640, 215),
        ("infineon-ff200r12ke3", 748, 110),
    ],
)
def test_least_weighted_loss_of_each_module(
    modules: Rows, device: str, watts: float, allowed: int
) -> None:
    mine = (modules.word("in.inverter.device") == device) & (np.array(modules.states) == "ok")
    assert np.sum(mine) == allowed
    best = np.argmin(np.where(mine, modules["out.losses.total"], np.inf))
    assert modules["out.losses.total"][best] == pytest.approx(watts, abs=0.5)
    assert modules.word("in.losses.modulations")[best] == "gdpwm"
    assert modules["in.inverter.switching_frequency"][best] == 8000.0


@pytest.mark.parametrize(
    ("device", "state", "words"),
    [
        ("microchip-mscsm70am10ct3ag", "limit", "beyond the ends of the tables"),
        ("wolfspeed-c2m0045170d", "no-solution", "finds no balance of heat"),
        ("ti-csd19505ktt", "refused", "above the 80 V that Texas Instruments CSD19505KTT blocks"),
    ],
)
def test_modules_that_cannot_drive_say_why(
    modules: Rows, device: str, state: str, words: str
) -> None:
    mine = np.flatnonzero(modules.word("in.inverter.device") == device)
    assert {modules.states[row] for row in mine} == {state}
    assert all(words in modules.messages[row] for row in mine)


def test_own_device_and_a_gain_set_for_each_sampling_frequency() -> None:
    body = (
        """vary:
  together:
    inverter.switching_frequency: {range: {from: 60 kHz, to: 100 kHz, count: 3}}
    control.sampling_frequency: {range: {from: 60 kHz, to: 100 kHz, count: 3}}
  losses.modulations: {values: [gdpwm, svpwm], one_by_one: true}
set:
"""
        + POINTS
    )
    rows = Rows.of(plan_of(body))
    work = rows.plan.work
    assert (work.fits, work.gain_sets, work.budget_calls) == (1, 3, 1)
    assert set(rows.states) == {"ok"}


def test_least_loss_of_the_drives_own_device() -> None:
    body = _EXAMPLE.replace(f"  inverter.device: {{values: [{_DEVICES}]}}\n", "")
    rows = Rows.of(plan_of(body + outputs("losses.total", "losses.ripple_current")))
    fine = np.array(rows.states) == "ok"
    assert rows.plan.work.budget_calls == 1
    assert rows.plan.work.fits == 0  # nobody asked for it
    assert np.min(rows["out.losses.total"][fine]) == pytest.approx(348.0, abs=0.5)


_LINEAR = (
    MACHINES
    + "draw: {count: 200, seed: 5}\nset:\n"
    + POINTS
    + "  losses.modulations: [ddt-gdpwm]\n  fit.torque_max: 150 N m\n"
    + outputs(
        "reference.torque_max",
        "reference.i_d",
        "fit.error.i_d",
        "fit.path",
        *loop_names("i_d", "i_q"),
        "losses.total",
        "losses.junction_temperature",
        "losses.points.1.copper",
    )
)


@pytest.fixture(scope="module")
def drawn() -> Rows:
    """200 random linear machines."""
    return Rows.of(plan_of(_LINEAR))


@pytest.fixture(scope="module")
def singly(drawn: Rows) -> Rows:
    """The first of them, one design at a time."""
    plan = plan_of(_LINEAR)
    plan._made.grouping.bounds = {}
    return Rows.of(plan, 24)


def test_machines_go_together(drawn: Rows) -> None:
    work = drawn.plan.work
    assert drawn.plan.batch == TOGETHER_BATCH
    assert (work.fits, work.gain_sets, work.budget_calls) == (0, 0, 0)
    assert work.designs == 2**5  # the corners of five keys
    assert set(drawn.states) == {"ok"}
    assert set(drawn.word("out.fit.path")) == {"batch"}


@pytest.mark.parametrize(
    ("name", "tolerance"),
    [
        ("reference.torque_max", 1e-12),
        ("reference.i_d", 1e-12),
        *((name, 1e-8 if name.endswith("sensitivity") else 1e-12) for name in loop_names("i_d")),
        *((name, 1e-8 if name.endswith("sensitivity") else 1e-12) for name in loop_names("i_q")),
        ("losses.total", 1e-12),
        ("losses.junction_temperature", 1e-12),
        ("losses.points.1.copper", 1e-12),
        ("fit.error.i_d", 0.25),
    ],
)
def test_machines_together_are_those_one_by_one(
    drawn: Rows, singly: Rows, name: str, tolerance: float
) -> None:
    assert singly.plan.work.fits == 24
    together, alone = drawn[f"out.{name}"][:24], singly[f"out.{name}"]
    np.testing.assert_allclose(together, alone, rtol=tolerance)


def test_speed_loops_without_an_observer_go_together() -> None:
    body = (
        MACHINES.replace("machine.max_current: {uniform: 5 %}", "machine.inertia: {normal: 10 %}")
        + "draw: {count: 20, seed: 3}\nset:\n"
        + "  control: {sampling_frequency: 100 kHz, speed_loop: {ratio: 10}}\n"
        + outputs("gains.phase_margin", *loop_names("i_q", "speed"))
    )
    plan = plan_of(body)
    assert plan.batch == TOGETHER_BATCH
    rows = Rows.of(plan)
    single = plan_of(body)
    single._made.grouping.bounds = {}
    alone = Rows.of(single, 3)
    assert (plan.work.gain_sets, single.work.gain_sets) == (0, 3)
    for name in ("gains.phase_margin", *loop_names("i_q", "speed")):
        np.testing.assert_allclose(rows[f"out.{name}"][:3], alone[f"out.{name}"], rtol=1e-7)


def test_rows_are_the_same_in_any_block(drawn: Rows) -> None:
    plan = pickle.loads(pickle.dumps(drawn.plan))
    pieces = [plan.rows(150, 200), plan.rows(0, 7), plan.rows(7, 150)]
    whole = drawn.blocks[0]
    for name, column in whole.columns.items():
        joined = np.concatenate([pieces[k].columns[name] for k in (1, 2, 0)])
        assert joined.tobytes() == column.tobytes(), name
    keys = np.concatenate([pieces[k].keys for k in (1, 2, 0)])
    assert keys.tobytes() == whole.keys.tobytes()


def test_audit_compares_every_thousandth_row(drawn: Rows) -> None:
    audited = drawn.blocks[0].audited
    assert audited["reference.torque_max"] < 1e-12
    assert audited["losses.total"] < 1e-12
    assert 0.0 < audited["fit.error.i_d"] < 0.25  # another way to fit: not the same number
    assert "fit.path" not in audited
    assert not drawn.plan.rows(1, 200).audited


def test_a_row_never_stops_a_study() -> None:
    body = (
        "vary:\n  machine.max_current: {values: [180 A, 283 A]}\n"
        "  fit.torque_max: {values: [100 N m, 200 N m]}\n"
        "limits: {reference.torque_max: {above: 140 N m}}\n"
        + outputs("reference.torque_max", "fit.error.i_d")
    )
    rows = Rows.of(plan_of(body))
    assert rows.states == ["limit", "no-solution", "ok", "ok"]
    assert "200 N m is out of reach" in rows.messages[1]
    assert rows.messages[0].startswith("study.yaml:7:10: limits.reference.torque_max: 1")
    assert rows.messages[0].endswith("N m is below 140 N m")
    assert not any(rows.messages[2:])
    assert rows["out.reference.torque_max"][1] > 0.0  # what could be computed stays


def test_a_refused_row_says_what_the_command_says() -> None:
    body = "vary:\n  inverter.v_dc: {values: [500 V, 0 V]}\n" + outputs("reference.torque_max")
    rows = Rows.of(plan_of(body))
    assert rows.states == ["ok", "refused"]
    assert rows.messages[1].startswith("study.yaml:5:")
    assert np.isnan(rows["out.reference.torque_max"][1])


def test_limits_leave_room_for_rounding() -> None:
    plan = plan_of(outputs("reference.torque_max"))
    most = float(Rows.of(plan)["out.reference.torque_max"][0])
    for factor, state in ((1.0 - 2e-10, "ok"), (1.0 - 1e-8, "limit")):
        limit = f"limits: {{reference.torque_max: {{below: {most * factor:.15g} N m}}}}\n"
        rows = Rows.of(plan_of(limit + outputs("reference.torque_max")))
        assert rows.states == [state]


def test_gains_that_nobody_asked_for_leave_a_row_as_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    def none(_: object, *, proofs: bool) -> tuple[None, str]:
        assert not proofs
        return None, "no loop was requested and none was found: too slow"

    monkeypatch.setattr(block_rows, "gains_or_reason", none)
    rows = Rows.of(plan_of("", "thor-pmsyrm-5k"))
    assert rows.states == ["ok"]
    assert np.isnan(rows["out.gains.phase_margin"][0])
    rows = Rows.of(plan_of(outputs("gains.phase_margin"), "thor-pmsyrm-5k"))
    assert rows.states == ["no-solution"]
    assert rows.messages[0].endswith("no loop was requested and none was found: too slow")


def test_kinds_of_studies_have_their_batches() -> None:
    header = "header: nominal\n" + MACHINES + "draw: {count: 50, seed: 1}\n"
    assert plan_of(header).batch == YIELD_BATCH
    observed = MACHINES + "draw: {count: 50, seed: 1}\n"
    assert plan_of(observed).batch == SINGLE_BATCH  # a speed loop on an observer, row by row


def test_a_fixed_header_on_drawn_machines() -> None:
    body = (
        "header: nominal\n"
        + MACHINES.replace("  machine.max_current: {uniform: 5 %}\n", "")
        + "  inverter.v_dc: {uniform: 10 %}\n"
        + "draw: {count: 4000, seed: 20261122}\n"
        + """accept:
  reference.torque_error: {below: 5 %}
  reference.loss_penalty: {below: 0.3 %}
  gains.phase_margin: {above: 68 deg}
  losses.total: {below: 800 W, point: {torque: 130 N m, speed: 300 rad/s, modulation: ddt-gdpwm}}
"""
    )
    rows = Rows.of(plan_of(body))
    error, penalty = rows["out.reference.torque_error"], rows["out.reference.loss_penalty"]
    margin, loss = rows["out.gains.phase_margin"], rows["out.losses.points.0.ddt-gdpwm.total"]
    good = (error < 0.05) & (penalty < 0.003) & (margin > np.radians(68.0)) & (loss < 800.0)
    assert np.mean(good) == pytest.approx(0.795, abs=0.02)  # 4,000 rows: three sigma
    assert np.degrees([margin.min(), margin.max()]) == pytest.approx([68.9, 72.1], abs=0.4)
    assert loss.min() > 764.0
    assert loss.max() < 799.0
    assert all(deviation < 1e-9 for deviation in rows.blocks[0].audited.values())


def test_a_header_refuses_what_is_fixed_with_it() -> None:
    body = "header: nominal\n" + MACHINES + "draw: {count: 5, seed: 1}\n"
    with pytest.raises(InputError, match=r"study\.yaml:\d+:\d+: outputs.*omit header"):
        plan_of(body + outputs("reference.torque_max"))


@pytest.mark.slow
def test_every_library_drive_has_rows() -> None:
    for design in ("abb-ipmsm-2k2", "baldor-pmsyrm-5k6", "paper001-pmsm-bench"):
        rows = Rows.of(plan_of("", design))
        assert rows.states == ["ok"], rows.messages
