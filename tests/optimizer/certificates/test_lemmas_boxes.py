"""Newton's box with derivatives given as balls: what each width, rounding and derivative adds,
in plain numbers.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest
from flint import arb, arb_series, ctx
from lemma_cases import MACHINE, close, interval, local, plain, task_of

from dqforge.optimizer.certificates import current_reference as interval_newton
from dqforge.optimizer.certificates.ball import ORDER, Value, jets
from dqforge.optimizer.certificates.current_reference import UNKNOWN, Bounds, Interval, newton
from dqforge.optimizer.operating_points.current_choice import SpeedPoint


@pytest.fixture(autouse=True)
def ball_context() -> Iterator[None]:
    before = ctx.prec, ctx.cap
    ctx.prec, ctx.cap = 80, ORDER + 1
    yield
    ctx.prec, ctx.cap = before


@dataclass
class Constant:
    """A piece of a reference whose currents do not depend on the torque."""

    i_d: arb
    i_q: arb
    rounded: tuple[float, float]

    def currents(self, torque: Value) -> tuple[Value, Value]:
        return torque * 0 + self.i_d, torque * 0 + self.i_q

    def rounding(self, _torque: arb) -> tuple[arb, arb]:
        return arb(self.rounded[0]), arb(self.rounded[1])


@dataclass
class Stage:
    """What the method sees in place of a machine, and what it was asked."""

    t_d: tuple[float, float] = (0.5, 0.03125)
    t_q: tuple[float, float] = (-1.5, 0.0625)
    c_d: tuple[float, float] = (2.0, 0.125)
    c_q: tuple[float, float] = (1.25, 0.0625)
    steps: tuple[float, float] = (-0.0625, 0.03125)
    spread: float = 0.0
    """Radius of both steps."""
    second: tuple[float, float] = (-0.015625, 0.0078125)
    error: tuple[float, float] = (-0.25, 0.125)
    rounded: tuple[float, float] = (0.0078125, 0.015625)
    centre: tuple[float, float] = (-1.0, 5.0)
    width: float = 0.25
    """Radius of both currents."""
    grows: bool = False
    boxes: list[tuple[arb, arb]] = field(default_factory=list)
    formulas: list[tuple[arb, arb]] = field(default_factory=list)
    asked: dict[str, Any] = field(default_factory=dict)

    def interval(self) -> Interval:
        piece = Constant(
            arb(self.centre[0], self.width), arb(self.centre[1], self.width), self.rounded
        )
        return Interval(piece, 4.0, 4.5, 0, UNKNOWN.values())  # type: ignore[arg-type]

    def install(self, patch: pytest.MonkeyPatch) -> None:
        s_d, s_q = (arb(step, self.spread) for step in self.steps)
        row = [arb(*self.error), arb(*self.second), s_d, s_q, arb(0.125)]

        def some_jets(_machine: object, i_d: arb, i_q: arb) -> list[object]:
            self.formulas.append((i_d, i_q))
            return [None]

        def over_box(_task: object, box: tuple[arb, arb], _condition: object) -> Any:
            self.boxes.append(box)
            factor = 4.0 ** len(self.boxes) if self.grows else 1.0
            parts = {name: getattr(self, name) for name in ("t_d", "t_q", "c_d", "c_q")}
            found = local()
            return type(found)(
                *(
                    arb(parts[name][0], parts[name][1] * factor) if name in parts else arb(0)
                    for name in found.__dataclass_fields__
                )
            )

        def penalty(
            _task: object, _at: object, box: object, missed: arb, inverse: arb, _c: object
        ) -> Any:
            self.asked.update(box=box, missed=missed, inverse=inverse)
            return 11.0, 13.0

        def excess(
            _task: object, ball: arb, _at: object, rounding_d: arb, rounding_q: arb
        ) -> float:
            self.asked.update(excess=ball, rounding=(rounding_d, rounding_q))
            return 17.0

        def series(*_: object) -> Any:
            return lambda torque: [torque * 0 + one for one in row]

        patch.setattr(interval_newton, "jets", some_jets)
        patch.setattr(interval_newton, "_series", series)
        patch.setattr(interval_newton, "conditions_over_box", over_box)
        patch.setattr(interval_newton, "_penalty", penalty)
        patch.setattr(interval_newton, "_voltage_excess", excess)

    def inverse(self) -> float:
        """Largest magnitude of 1/(t_d c_q - t_q c_d)."""
        middle = self.t_d[0] * self.c_q[0] - self.t_q[0] * self.c_d[0]
        radius = 0.0
        for (a, r), (b, s) in ((self.t_d, self.c_q), (self.t_q, self.c_d)):
            radius += abs(a) * s + abs(b) * r + r * s
        return 1.0 / (abs(middle) - radius)

    def most(self, name: str) -> float:
        middle, radius = getattr(self, name)
        return float(abs(middle) + radius)

    def step(self) -> np.ndarray:
        return np.abs(self.steps) + self.spread

    def distance(self) -> np.ndarray:
        """|s| + |J^-1| (2 rad J) |s|."""
        s = self.step()
        moved = [
            2.0 * self.t_d[1] * s[0] + 2.0 * self.t_q[1] * s[1],
            2.0 * self.c_d[1] * s[0] + 2.0 * self.c_q[1] * s[1],
        ]
        more = np.array(
            [
                self.most("c_q") * moved[0] + self.most("t_q") * moved[1],
                self.most("c_d") * moved[0] + self.most("t_d") * moved[1],
            ]
        )
        return np.asarray(s + more * self.inverse())

    def missed(self) -> float:
        return (
            self.most("second")
            + self.most("c_d") * self.rounded[0]
            + self.most("c_q") * self.rounded[1]
        )

    def needed(self) -> np.ndarray:
        """Room for the distance or the rounding, and along the curve of constant torque beside."""
        along = np.array([self.most("t_q"), self.most("t_d")]) * self.inverse() * self.missed()
        return np.asarray(np.maximum(self.distance(), self.rounded) + along)

    def first_reach(self) -> np.ndarray:
        return np.asarray(1.3 * self.step() + 2.0 * np.array(self.rounded))


def radii(box: tuple[arb, arb]) -> np.ndarray:
    return np.array([float(part.rad()) for part in box])


def sharp(**changes: Any) -> Stage:
    """A case whose first box is wide enough."""
    basis: dict[str, Any] = {
        "steps": (-0.25, 0.5),
        "spread": 0.03125,
        "second": (-0.00390625, 0.001953125),
        "t_d": (0.5, 0.015625),
        "t_q": (-1.5, 0.0078125),
        "c_d": (2.0, 0.015625),
        "c_q": (1.25, 0.03125),
        "rounded": (0.0078125, 0.015625),
    }
    return Stage(**(basis | changes))


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"t_d": (-0.5, 0.03125), "c_q": (-1.25, 0.015625)},
        {"t_d": (0.5, 0.0625), "t_q": (-1.5, 0.0)},
        {"c_d": (2.0, 0.0625), "c_q": (1.25, 0.0)},
        {"t_q": (-1.5, 0.03125)},
        {"error": (0.5, 0.0625), "second": (0.00390625, 0.001953125)},
    ],
)
def test_distance_and_torque_of_one_box(
    monkeypatch: pytest.MonkeyPatch, changes: dict[str, Any]
) -> None:
    stage = sharp(**changes)
    stage.install(monkeypatch)
    assert np.all(stage.needed() < stage.first_reach())
    found = newton(task_of(), stage.interval(), "loss")
    expected = stage.distance() + stage.rounded
    close(found.i_d, expected[0], 1e-6)
    close(found.i_q, expected[1], 1e-6)
    torque = (
        stage.most("error")
        + stage.most("t_d") * stage.rounded[0]
        + stage.most("t_q") * stage.rounded[1]
    )
    close(found.torque, torque, 1e-6)
    assert (found.loss, found.loss_relative, found.voltage_excess) == (11.0, 13.0, 17.0)
    close(float(stage.asked["missed"].abs_upper()), stage.missed(), 1e-6)
    close(float(stage.asked["inverse"].abs_upper()), stage.inverse(), 1e-6)
    assert float(stage.asked["excess"].mid()) == 0.125
    assert tuple(map(float, stage.asked["rounding"])) == stage.rounded
    (box,) = stage.boxes
    assert stage.asked["box"] is box
    np.testing.assert_allclose(radii(box), stage.width + stage.first_reach(), rtol=1e-6)
    np.testing.assert_allclose([float(part.mid()) for part in box], stage.centre)
    (asked,) = stage.formulas
    np.testing.assert_allclose(radii(asked), stage.width + np.array(stage.rounded), rtol=1e-6)
    np.testing.assert_allclose([float(part.mid()) for part in asked], stage.centre)


@pytest.mark.parametrize("tight", ["d", "q"])
def test_a_box_that_is_too_narrow_grows_to_what_is_needed(
    monkeypatch: pytest.MonkeyPatch, tight: str
) -> None:
    """One current without room is enough; then 1.3 times what was needed,
    whichever of rounding and distance rules.
    """
    few, more = (0.0009765625, 0.5), (-0.5, 0.0009765625)
    steps = {"d": few, "q": more}[tight]
    stage = sharp(
        steps=steps,
        spread=0.0,
        rounded={"d": (0.0, 0.015625), "q": (0.015625, 0.0)}[tight],
        second=(-0.0625, 0.03125),
    )
    stage.install(monkeypatch)
    short = stage.needed() >= stage.first_reach()
    assert short.tolist() == [tight == "d", tight == "q"]
    newton(task_of(), stage.interval(), "loss")
    first, second = stage.boxes
    np.testing.assert_allclose(radii(first), stage.width + stage.first_reach(), rtol=1e-6)
    np.testing.assert_allclose(radii(second), stage.width + 1.3 * stage.needed(), rtol=1e-6)


def test_rounding_is_held_where_it_is_the_larger(monkeypatch: pytest.MonkeyPatch) -> None:
    stage = sharp(
        steps=(-0.0009765625, 0.0009765625), spread=0.0, rounded=(0.25, 0.125), second=(-0.5, 0.25)
    )
    stage.install(monkeypatch)
    assert np.all(stage.distance() < stage.rounded)
    assert np.any(stage.needed() >= stage.first_reach())
    newton(task_of(), stage.interval(), "loss")
    np.testing.assert_allclose(
        radii(stage.boxes[-1]), stage.width + 1.3 * stage.needed(), rtol=1e-6
    )


def test_a_box_that_needs_three_times_its_room_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    """Just below three times both together the box grows once, above it is given up at once."""

    def case(second: float) -> Stage:
        return sharp(second=(second, 0.0), spread=0.0, rounded=(0.0009765625, 0.001953125))

    def share(stage: Stage) -> float:
        return float(np.sum(stage.needed()) / np.sum(stage.first_reach()))

    low, high = 0.0, 100.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if share(case(middle)) < 3.0 else (low, middle)
    below, above = case(low * 0.999), case(high * 1.001)
    with monkeypatch.context() as patch:
        below.install(patch)
        newton(task_of(), below.interval(), "loss")
    assert len(below.boxes) == 2
    above.install(monkeypatch)
    with pytest.raises(ZeroDivisionError):
        newton(task_of(), above.interval(), "loss")
    assert len(above.boxes) == 1


def test_a_box_with_a_vanishing_determinant_holds_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    stage = sharp(t_d=(0.5, 9.0))
    stage.install(monkeypatch)
    with pytest.raises(ZeroDivisionError):
        newton(task_of(), stage.interval(), "loss")
    assert len(stage.boxes) == 1


def test_first_step_solves_the_linear_equations() -> None:
    """s = J^-1 (tau - T, c) at currents at which neither vanishes, and the
    excess of the voltage beside.
    """
    task, torque, i_d, i_q = task_of(SpeedPoint(20.0, 8.0)), 3.0, -1.5, 2.5
    piece = Constant(arb(i_d), arb(i_q), (0.0, 0.0))
    (formula,) = jets(MACHINE, arb(i_d), arb(i_q))
    row = interval_newton._series(task, piece, formula, "loss")(arb_series([arb(torque), 1]))  # type: ignore[arg-type]
    error, second, step_d, step_q, excess = (float(one[0]) for one in row)
    at = plain(MACHINE, i_d, i_q)
    jacobian = np.array([[at["t_d"], at["t_q"]], [at["c_d"], at["c_q"]]])
    step = np.linalg.solve(jacobian, [at["torque"] - torque, at["c"]])
    volts = np.hypot(
        *MACHINE.voltage(np.array([i_d]), np.array([i_q]), np.array([MACHINE.pole_pairs * 20.0]))
    )
    expected = [at["torque"] - torque, at["c"], *step, (float(volts[0]) / 8.0) ** 2 - 1.0]
    assert [error, second, step_d, step_q, excess] == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("condition", ["loss", "voltage"])
def test_penalty_of_balls_is_the_largest(condition: Any) -> None:
    """The Lagrangian's square is above by its radius, the least loss below
    by those of the currents.
    """
    t_d, t_q, missed, inverse = 0.5, 1.5, 0.125, 0.5
    i_d, i_q, radius = -2.0, 4.0, 0.125
    box = arb(i_d, radius), arb(i_q, radius)
    at = local(t_d=t_d, t_q=t_q)
    shift = missed * inverse
    if condition == "loss":
        more = (t_d**2 + t_q**2) * shift**2
    else:
        more = 2.0 * (abs(i_q * t_d - i_d * t_q) + radius * (abs(t_d) + abs(t_q))) * shift
    least = (abs(i_d) - radius) ** 2 + (abs(i_q) - radius) ** 2 - more
    # The square of a ball about its middle: as wide above as below.
    around = i_d**2 + i_q**2 - 2.0 * radius * (abs(i_d) + abs(i_q)) - 2.0 * radius**2 - more
    loss, relative = interval_newton._penalty(
        task_of(), at, box, arb(missed), arb(inverse), condition
    )
    close(loss, 1.5 * MACHINE.r_s * more, 1e-6)
    assert more / least * (1.0 - 1e-9) <= relative <= more / around * (1.0 + 1e-6)


def test_widths_of_gradients_count() -> None:
    """The upper ends of the gradient's magnitudes, not the lower ones, carry the rounding."""
    task = task_of(SpeedPoint(30.0, 12.0))
    at = local()
    wide = type(at)(
        *(
            {"e_d": arb(-0.5, 0.25), "e_q": arb(0.25, 0.125)}.get(name, arb(0))
            for name in at.__dataclass_fields__
        )
    )
    found = interval_newton._voltage_excess(task, arb(0.25), wide, arb(0.5), arb(0.25))
    close(found, math.sqrt(1.0 + 0.25 + 0.75 * 0.5 + 0.375 * 0.25) - 1.0, 1e-6)


def test_torque_room_over_a_box(monkeypatch: pytest.MonkeyPatch) -> None:
    """Over torques from 3 to 5 N m: |dtau/di_d| and |dtau/di_q| at their
    largest times the rounding.
    """
    task = task_of()
    here = interval(task, 3.0, 5.0)
    rounded = (0.03125, 0.0625)

    class Rounded(Constant):
        def currents(self, torque: Value) -> tuple[Value, Value]:
            i_d, i_q = here.piece.currents(torque)
            return i_d, i_q

    piece = Rounded(arb(0), arb(0), rounded)
    wide = Interval(piece, 3.0, 5.0, 0, UNKNOWN.values())  # type: ignore[arg-type]
    error, excess = interval_newton.torque_and_voltage(task, wide)
    sharp_error, _ = interval_newton.torque_and_voltage(
        task,
        Interval(Rounded(arb(0), arb(0), (0.0, 0.0)), 3.0, 5.0, 0, UNKNOWN.values()),  # type: ignore[arg-type]
    )
    # A flux linkage and an inductance times the same current are two balls: their radii add.
    middle, both = plain(MACHINE, -1.0, 5.0), 1.5 * MACHINE.pole_pairs * (MACHINE.l_d + MACHINE.l_q)
    t_d = abs(middle["t_d"]) + both * (1.25 + rounded[1])
    t_q = abs(middle["t_q"]) + both * (0.25 + rounded[0])
    room = t_d * rounded[0] + t_q * rounded[1]
    assert float(error.rad() - sharp_error.rad()) == pytest.approx(room, rel=1e-5)
    assert excess == 0.0


def test_halves_of_halves_are_deeper() -> None:
    whole = interval(task_of(), 1.0, 4.0)
    part = whole.halves(np.zeros(6))[0].halves(np.zeros(6))[1]
    assert part.depth == 2
    assert (part.low, part.high) == (1.75, 2.5)


def test_bounds_keep_their_order() -> None:
    np.testing.assert_array_equal(Bounds(1, 2, 3, 4, 5, 6).values(), [1, 2, 3, 4, 5, 6])
