"""A step in integers that uses every word of their arithmetic, written as C, compiled under the
sanitizer, and equal to the same step on numbers; what the firmware would compute twice is refused.
"""

from __future__ import annotations

import re
import subprocess
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Generic, NamedTuple

import numpy as np
import pytest
from fixed_drives import observed_design
from static_checks import program

from dqforge.machines.transforms import N, Pair
from dqforge.optimizer.fixed_control.codes import rotation
from dqforge.optimizer.fixed_observers.fixed_observer_fit import (
    FixedObserverFit,
    FixedPositionObserver,
    observer_reaches,
)
from dqforge.optimizer.fixed_observers.kit import (
    TOP,
    WIDTH,
    FixedMethod,
    FixedPolynomials,
    TrackedState,
    Word,
    clipped,
    clipped_vector,
    code_limits,
    polynomial,
    predicted,
    quotient,
    speed_size,
    times,
    to_rotor,
    to_stator,
    vector_words,
)
from dqforge.optimizer.loops.integer_gains import FixedGain
from dqforge.optimizer.steps.code_vectors import Dq
from dqforge.optimizer.steps.integer_arithmetic import Arithmetic, Range, rounded, scaled
from dqforge.optimizer.steps.step_arithmetic import Member
from dqforge.reports.fixed_observers.fixed_observer_header import (
    fixed_observer_files,
    fixed_observer_harness,
    row_inputs,
    row_results,
)
from dqforge.reports.steps.integer_text import integer_observer_text
from dqforge.reports.verification.host import WARNINGS


@dataclass(frozen=True, slots=True)
class FixedTried:
    """Gains of a step that uses every word."""

    share: Annotated[FixedGain, Member("of the speed")]
    curve: FixedPolynomials
    most: Annotated[int, Member("limit")]
    far: Annotated[int, Member("beyond 32 bits"), "int64_t"]
    bits: Annotated[int, Member("fractional bits"), "uint32_t"]


class Parts(NamedTuple, Generic[N]):
    """Two numbers of their own type."""

    near: Annotated[N, Member("a code")]
    far: N


GAINS = FixedTried(
    FixedGain(-1_700_000_001, 30, -1.583),
    FixedPolynomials(((77_000_001, -5_000_003, 901), (-3, 400_000_007, 1)), 27),
    1_900_000_000,
    2**40 + 3,
    20,
)


def parts_of(o: Arithmetic[N, Any], gains: FixedTried, x: N, far: N) -> Parts[N]:
    """Both parts."""
    own = o.let("own", o.call(polynomial, gains.curve.rows[1], x))
    held = o.let("held", o.clamp(far, -5, gains.far))
    return Parts(o.clamp(own, -gains.most, gains.most), held)


def wide(o: Arithmetic[N, Any], a: Pair[N], b: Pair[N]) -> Pair[N]:
    """A sum that no code holds."""
    return Pair(o.total("sum", a.x, b.x), o.total("sum", a.y, o.negative(b.y)))


def begin(
    o: Arithmetic[N, Any], gains: FixedTried, state: TrackedState[N], v: Pair[N], i: Pair[N]
) -> TrackedState[N]:
    """Constants, and a vector in another frame."""
    del v
    first = o.let("first", o.call(rotation, WIDTH, state.theta))
    seen = o.let("seen", o.call(to_rotor, i, first))
    return TrackedState(state.theta, state.omega, (seen.x, seen.y, o.const(gains.far), i.x))


def step(
    o: Arithmetic[N, Any], gains: FixedTried, state: TrackedState[N], v: Pair[N], i: Pair[N]
) -> TrackedState[N]:
    """One sample."""
    theta = o.let("theta", o.call(predicted, gains.share, state.theta, state.omega))
    ahead = o.let("ahead", o.call(predicted, gains.share, o.const(0), i.y))
    turn = o.let("turn", o.call(rotation, WIDTH, ahead))
    back = o.let("back", o.call(to_stator, o.let("own", Dq(v.x, i.x)), turn))
    o.remark("what no code holds")
    both = o.let("both", o.call(wide, back, i), "two numbers of 64 bits")
    kept = o.let("kept", o.call(clipped_vector, both.x, both.y))
    size = o.let("size", o.call(speed_size, state.omega))
    x = o.let("x", o.call(times, "square", size, size))
    parts = o.let(
        "parts", o.call(parts_of, gains, x, o.product("far", o.shifted(size, 16), state.words[2]))
    )
    a, b = o.let("a", o.shifted(kept.x, 16)), o.let("b", o.shifted(v.y, 16))
    squares = [
        o.let(f"square_{n}", o.known(o.product("a^2", part, part), 0, 2**30))
        for n, part in enumerate((a, b))
    ]
    length = o.let("length", o.clamp(o.let("root", o.root(o.total("length", *squares))), 3, 40_000))
    ratio = o.quotient("32 bits", state.words[0], length)
    over = o.let("over", o.call(quotient, "over", kept.y, o.total("p", x, parts.near), gains.bits))
    places = o.let("places", o.halvings("p", parts.far, 2**20 - 1))
    short = o.known(o.shifted_by(parts.far, places), -5, 2**20 - 1)
    low = o.wrapped(kept.x, 9)
    mixed = o.let("mixed", o.total("mixed", o.product("low", low, short), ratio, o.const(-7)))
    limited = o.within(o.call(rounded, "mixed", mixed, 3), length)
    ahead_of = o.at_least(kept.y, o.negative(o.const(gains.most)))
    chosen = o.let("chosen", o.choose(ahead_of, o.negative(limited), over))
    listed = o.let("listed", [o.call(times, "list", chosen, part) for part in (a, over)])
    good = o.every(
        o.at_least(listed[0], o.const(-900)),
        o.at_least(o.const(2**31), kept.x),
        o.at_least(o.const(900_000_000), listed[1]),
    )

    def kept_on() -> TrackedState[N]:
        speed = o.total("speed", state.omega, o.call(scaled, "share", gains.share, chosen))
        # Members that change places.
        return TrackedState(
            theta, o.call(clipped, speed), (state.words[1], kept.y, parts.far, state.words[0])
        )

    def anew() -> TrackedState[N]:
        return begin(o, gains, TrackedState(state.theta, parts.near, ()), i, i)

    return o.either(good, kept_on, anew)


def limits(_: Any) -> tuple[Range, ...]:
    far = GAINS.far
    return (*code_limits(2)(None), Range(-far, far), *code_limits(1)(None))


METHOD = FixedMethod(
    name="flux",
    code="tried",
    gains=FixedTried,
    design=lambda gains, _: gains,
    words=(Word("e.d", meaning="a vector"), Word("e.q"), Word("far", "int64_t"), Word("last")),
    limits=limits,
    begin=begin,
    step=step,
)


@pytest.mark.parametrize("width", [16, 32])
def test_the_c_of_a_step_is_the_step(width: int, tmp_path: Path) -> None:
    observer = FixedPositionObserver(METHOD, GAINS, width, (1.0, 1.0, 1.0), 0.1)
    fit = FixedObserverFit(observer, observer_reaches(METHOD, GAINS, width), 1.0)
    design = observed_design("flux")
    for file, content in fixed_observer_files(design, fit).items():
        (tmp_path / file).write_bytes(content)
    prefix = design.export.prefix
    (tmp_path / "main.c").write_text(fixed_observer_harness(observer).source(prefix))
    strict = ["-std=c99", "-O2", *WARNINGS, "-Wsign-conversion", "-Wshadow"]
    checked = ["-fsanitize=undefined", "-fno-sanitize-recover=all", "-Wno-overlength-strings"]
    command = [program("gcc"), *strict, *checked, "main.c", "-o", "run"]
    subprocess.run(command, cwd=tmp_path, check=True)
    rows = row_inputs(observer, 4000, 7)
    done = subprocess.run(
        [tmp_path / "run"], input=rows.astype("i8").tobytes(), capture_output=True, check=False
    )
    assert done.returncode == 0, done.stderr.decode()
    expected = row_results(observer, rows)
    assert np.array_equal(np.frombuffer(done.stdout, "i8").reshape(len(rows), -1), expected)
    assert all(np.unique(column).size > 20 for column in expected.T)


def test_types_are_those_of_the_ranges() -> None:
    """Types as ranges ask for, functions once, comments, both branches, and one order of writes."""
    text = integer_observer_text(METHOD, GAINS, 16, "t", "T")
    assert "static inline int32_t t_times_q15(int32_t a, int32_t b)" in text
    assert "t_predicted_q15(t_gain_core_t advance, uint32_t theta, int32_t omega)" in text
    assert re.search(r"    int64_t far; +/\* beyond 32 bits \*/", text)
    assert text.count("static inline int32_t t_polynomial_q15(") == 1
    assert "    int32_t near; /* a code */\n    int64_t far;\n} t_parts_q15_t;" in text
    assert "const t_wide_q15_t both" in text
    assert "/* what no code holds */" in text
    # The upper limit holds every code: nothing is compared.
    assert "(listed_0 >= -900)" in text
    assert "2147483648" not in text.split("if (", 2)[2].split("{")[0]
    written = re.findall(r"observer->(\S+) = ", text.split("listed_1 =")[1])
    assert written.index("last") < written.index("e.d") < written.index("e.q")


def _method(part: Callable[[Any, TrackedState[Any], Pair[Any]], Any]) -> FixedMethod:
    def own(o: Any, gains: Any, state: Any, v: Any, i: Any) -> Any:
        del gains, v
        return TrackedState(state.theta, part(o, state, i), state.words)

    words = vector_words(e="vector")
    return replace(METHOD, words=words, limits=code_limits(2), begin=own, step=own)


def test_what_would_be_computed_twice_is_refused() -> None:
    def twice(o: Any, state: TrackedState[Any], i: Pair[Any]) -> Any:
        sum_ = o.total("sum", state.omega, i.x)
        return o.call(clipped, o.total("twice", sum_, sum_))

    with pytest.raises(ValueError, match="is used twice: name it by `let`"):
        integer_observer_text(_method(twice), GAINS, 16, "t", "T")


def test_a_vector_without_a_name_is_not_handed_on() -> None:
    def handed(o: Any, state: TrackedState[Any], i: Pair[Any]) -> Any:
        turn = o.let("turn", o.call(rotation, WIDTH, state.theta))
        return o.let("seen", o.call(to_rotor, Pair(i.y, i.x), turn)).x

    with pytest.raises(ValueError, match="a vector is handed on by its name"):
        integer_observer_text(_method(handed), GAINS, 16, "t", "T")


def test_a_name_is_given_once() -> None:
    def named(o: Any, state: TrackedState[Any], i: Pair[Any]) -> Any:
        o.let("x", o.clamp(state.omega, -TOP, 5))
        return o.let("x", o.clamp(i.x, -TOP, 5))

    with pytest.raises(ValueError, match="there is a x already"):
        integer_observer_text(_method(named), GAINS, 16, "t", "T")
