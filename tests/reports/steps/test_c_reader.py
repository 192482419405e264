"""Random steps written as C, compiled, and equal bit for bit to the same step on arrays of float32;
what the firmware would compute twice, or in another order, is refused.
"""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pytest
from static_checks import program

from dqforge.optimizer.curves.single_precision import SINGLE
from dqforge.optimizer.observers.methods.registry import METHODS
from dqforge.optimizer.observers.parts import ObserverState, StateMembers
from dqforge.optimizer.steps.step_arithmetic import AlphaBeta, Arithmetic, Member, cast, limited
from dqforge.reports.steps.control_types import control_types
from dqforge.reports.steps.observer_text import observer_text

ROWS = 2000
SPECIAL = np.array(
    [np.nan, np.inf, -np.inf, 0.0, -0.0, 1e-45, -1e-40, 3.4e38, 65536.0, 3.1415927, -3.1415927],
    dtype=np.float32,
)


@dataclass(frozen=True, slots=True)
class TriedGains:
    """Gains of a step that uses every word of an arithmetic."""

    k: Annotated[tuple[float, ...], Member("polynomial")]
    limit: Annotated[float, Member("limit", "rad/s")]
    unread: float


Step = Callable[[Any, ObserverState, Any, Any, Arithmetic], ObserverState]

MEMBERS = StateMembers((("e", Member("vector")),), (("n", Member("scalar")), ("m", Member(""))))


def start(theta_e: Any, omega_e: Any) -> ObserverState:
    zero = np.zeros_like(theta_e)
    return ObserverState(((zero, zero),), theta_e, omega_e, False, (zero, zero))


def horner(o: Arithmetic, k: tuple[float, ...], x: Any) -> Any:
    """Polynomial."""
    y = o.let("y", k[1] + k[2] * x)
    return k[0] - x * y


def tried(gains: Any, state: ObserverState, v: Any, i: Any, o: Arithmetic) -> ObserverState:
    """Members that change places, an array, a call and both branches."""
    n, m = state.scalars
    (e,) = state.vectors
    turn = o.let("turn", o.rotation(o.let("x", o.wrap(state.theta_e + 0.5 * v[0]))))
    seen = o.let("seen", o.park_inverse(o.let("d", o.park(v, turn)), turn))
    if not state.started:
        return replace(state, vectors=(seen,), started=True)
    c = o.let("c", np.array([i[0] - n, -i[1]]) * np.array([m, e[0]]))
    root = o.let("root", o.root(o.magnitude(c[0] + 1.5)) / (1e-3 + c[1]))
    speed = o.let("speed", o.call(horner, gains.k, root))
    held = o.let("held", limited(o, speed, gains.limit))
    own = o.let("own", n)
    share = o.cases(
        "share",
        ((own > 0.5) & (held < 1.0), lambda: 0.25 * o.let("half", 0.5 * own) - held),
        (own <= 0.5, lambda: o.real(o.whole(held))),
        otherwise=lambda: held,
    )
    swapped = o.cases(
        "swapped",
        (o.has_bit(o.let("count", o.whole(held)), 2), lambda: AlphaBeta(share, -seen.alpha)),
        otherwise=lambda: seen,
    )
    good = (held <= 1e3) & (held >= -1e3) & (c[1] < 2.0)
    return o.either(
        good,
        lambda: ObserverState((swapped,), o.wrap(state.theta_e + held), held, True, (m, own)),
        lambda: ObserverState((AlphaBeta(e[1], i[0]),), state.theta_e, state.omega_e, True, (n, m)),
    )


def method_of(step: Step) -> Any:
    own = replace(METHODS["flux"], name="tried", code="tried", gains=TriedGains, members=MEMBERS)
    return replace(own, start=start, step=step)


def both(gains: Any, state: ObserverState, v: Any, i: Any, o: Arithmetic) -> ObserverState:
    """Before and after the first step the same name is written, and of another value."""
    share = 0.25 if state.started else 0.5
    seen = o.let("seen", AlphaBeta(gains.limit * v[0] + share, v[1] * share))
    return ObserverState((seen,), o.wrap(i[0]), i[1], True, state.scalars)


def weighed(o: Arithmetic, k: tuple[float, ...], x: tuple[Any, ...], number: Any) -> Any:
    """Loops in loops."""

    def of(n: Any) -> Any:
        return o.summed("total", o.at(k, n), 2, lambda m: o.at(k, n + m) * o.at(x, m))

    y = o.each("y", 2, of)
    following = o.let("following", number * 2 - number + 1)
    part = o.let("part", o.at(x, following))
    return o.summed("last", part - y[0], 2, lambda n: o.at(y, n) * o.at(k, number))


def chosen(o: Arithmetic, k: tuple[float, ...], y: Any) -> Any:
    """A place by two comparisons."""
    return o.at(k, o.reached("n", [y >= -1.0, y >= 3.0]))


def found(o: Arithmetic, k: tuple[float, ...], x: tuple[Any, ...], y: Any) -> Any:
    """A place that is handed on."""
    return o.call(weighed, k, x, o.reached("n", [y > 0.0]))


def counted(gains: Any, state: ObserverState, v: Any, i: Any, o: Arithmetic) -> ObserverState:
    """An array, a place of it that is found, and loops."""
    x = o.let("x", (v[0], v[1] - gains.limit * i[0], i[0]), "an array")
    if not state.started:
        return replace(state, omega_e=o.call(chosen, gains.k, i[1]), started=True)
    return replace(state, omega_e=o.call(found, gains.k, x, v[1]))


@pytest.mark.parametrize("step", [tried, both, counted])
def test_the_c_of_a_step_is_the_step(step: Step, tmp_path: Path) -> None:
    gains = TriedGains((0.25, -1.5, 0.1), 300.0, 7.0)
    text = observer_text(method_of(step), gains, "t", "T")
    assert "unread" not in text
    members = ["s.e.alpha", "s.e.beta", "s.n", "s.m", "s.theta_e", "s.omega_e"]
    source = [
        "#include <math.h>\n#include <stdio.h>",
        control_types("t", "T"),
        text,
        "int main(void) { float r[11]; t_tried_t s;",
        "while (fread(r, sizeof r, 1, stdin) == 1) {",
        *(f"{member} = r[{n}];" for n, member in enumerate(members)),
        "s.started = r[10] > 0.0F;",
        "const t_alphabeta_t v = { r[6], r[7] }; const t_alphabeta_t i = { r[8], r[9] };",
        "t_tried_step(&T_TRIED_GAINS, &s, v, i);",
        f"const float o[] = {{ {', '.join(members)} }};",
        "fwrite(o, sizeof o, 1, stdout); } return 0; }",
    ]
    (tmp_path / "main.c").write_text("\n".join(source))
    flags = ["-std=c99", "-O2", "-Wall", "-Wextra", "-Wshadow", "-Wdouble-promotion", "-Werror"]
    command = [program("gcc"), *flags, "-ffp-contract=off", "main.c", "-o", "run", "-lm"]
    subprocess.run(command, cwd=tmp_path, check=True)
    generator = np.random.default_rng(3)
    rows = (4.0 * generator.standard_normal((ROWS, 11))).astype(np.float32)
    spoilt = generator.random(rows.shape) < 0.1
    rows = np.where(spoilt, SPECIAL[generator.integers(len(SPECIAL), size=rows.shape)], rows)
    done = subprocess.run(
        [tmp_path / "run"], input=rows.tobytes(), capture_output=True, check=True
    ).stdout
    found = np.frombuffer(done, dtype=np.float32).reshape(ROWS, -1)
    for started in (False, True):
        own = rows[:, 10] > 0.0 if started else ~(rows[:, 10] > 0.0)
        c = [rows[own, n].copy() for n in range(10)]
        state = ObserverState(((c[0], c[1]),), c[4], c[5], started, (c[2], c[3]))
        with np.errstate(all="ignore"):
            after = step(cast(gains, SINGLE), state, (c[6], c[7]), (c[8], c[9]), SINGLE)
        parts = [*after.vectors[0], *after.scalars, after.theta_e, after.omega_e]
        model = np.stack(parts, axis=1)
        assert model.dtype == np.float32
        same = found[own].view(np.uint32) == model.view(np.uint32)
        assert np.all(same | (np.isnan(found[own]) & np.isnan(model)))


def _twice(gains: Any, state: ObserverState, v: Any, i: Any, o: Arithmetic) -> ObserverState:
    x = gains.limit * v[0]
    return replace(state, omega_e=o.wrap(x * x), started=True)


def _unnamed(gains: Any, state: ObserverState, v: Any, i: Any, o: Arithmetic) -> ObserverState:
    turn = o.rotation(state.theta_e)
    return replace(state, omega_e=o.park(AlphaBeta(v[0], i[0]), turn).d, started=True)


def _apart(gains: Any, state: ObserverState, v: Any, i: Any, o: Arithmetic) -> ObserverState:
    turn = o.rotation(state.theta_e)
    return replace(state, omega_e=turn[0] + turn[1], started=True)


def _exchanged(gains: Any, state: ObserverState, v: Any, i: Any, o: Arithmetic) -> ObserverState:
    return replace(state, scalars=state.scalars[::-1], started=True)


def _same(gains: Any, state: ObserverState, v: Any, i: Any, o: Arithmetic) -> ObserverState:
    return replace(state, omega_e=o.let("x", -v[0]) + o.let("x", -v[1]), started=True)


def _shadowed(gains: Any, state: ObserverState, v: Any, i: Any, o: Arithmetic) -> ObserverState:
    def of(n: Any) -> Any:
        return o.summed("total", v[0], 2, lambda k: o.at(gains.k, k) * o.at(gains.k, n))

    o.each("y", 2, of)
    return replace(state, omega_e=o.summed("last", i[0], 2, lambda k: o.at(gains.k, k)))


def _branching(gains: Any, state: ObserverState, v: Any, i: Any, o: Arithmetic) -> ObserverState:
    return replace(state, omega_e=v[0] if v[0] > 0.0 else v[1], started=True)


@pytest.mark.parametrize(
    ("step", "error", "said"),
    [
        (_twice, ValueError, "used twice: name it by `let`"),
        (_apart, ValueError, "used twice: name it by `let`"),
        (_unnamed, ValueError, "a vector is handed on by its name"),
        (_exchanged, ValueError, "is needed after it changed"),
        (_same, ValueError, "there is a x already"),
        (_shadowed, ValueError, "there is a k already"),
        (_branching, TypeError, "cannot branch on a number"),
    ],
)
def test_what_the_firmware_would_do_otherwise_is_refused(
    step: Step, error: type[Exception], said: str
) -> None:
    with pytest.raises(error, match=said):
        observer_text(method_of(step), TriedGains((0.25, -1.5, 0.1), 300.0, 7.0), "t", "T")
