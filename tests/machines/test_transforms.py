"""One text of Clarke, Park and the zero sequence, in double and single precision,
in integers and on ranges.
"""

from __future__ import annotations

import ast
import math
from pathlib import Path

import numpy as np
import pytest

import dqforge
from dqforge.machines.arrays import FloatArray
from dqforge.machines.modulation.modulators import MODULATORS, modulate
from dqforge.machines.modulation.registry import load_turn, zero_sequence_of
from dqforge.machines.names import ModulationName
from dqforge.machines.transforms import (
    DOUBLES,
    Floats,
    Pair,
    Triple,
    clarke,
    clarke_inverse,
    clarke_matrix,
    dq_to_phases,
    park,
    park_inverse,
    phases_to_dq,
)
from dqforge.optimizer.fixed_control.codes import FIXED_MODULATORS, Codes
from dqforge.optimizer.steps.integer_arithmetic import Integers, Range, Ranges

SINGLES = Floats(np.float32)
ROOT = Path(dqforge.__file__).parent


def phases(angle: FloatArray, amplitude: float) -> Triple[FloatArray]:
    return Triple(*(amplitude * np.cos(angle - k * 2.0 * math.pi / 3.0) for k in range(3)))


# Away from the angles where the choice of the resting phase is a matter of rounding, but for
# chance.
ANGLE = np.random.default_rng(2).uniform(-math.pi, math.pi, 500)


def test_every_arithmetic_sees_the_same_vector() -> None:
    exact = phases(ANGLE, 0.9)
    turn = Pair(np.array(math.cos(0.3)), np.array(math.sin(0.3)))
    wanted = park(DOUBLES, clarke(DOUBLES, exact), turn)
    np.testing.assert_allclose(wanted.x, 0.9 * np.cos(ANGLE - 0.3), atol=1e-15)
    np.testing.assert_allclose(wanted.y, 0.9 * np.sin(ANGLE - 0.3), atol=1e-15)
    single = Triple(*(x.astype(np.float32) for x in exact))
    seen = park(
        SINGLES, clarke(SINGLES, single), Pair(*(np.array(x, dtype=np.float32) for x in turn))
    )
    assert seen.x.dtype == np.float32
    np.testing.assert_allclose(np.stack(seen), np.stack(wanted), atol=4e-7)
    codes = Codes(Integers(), 16)
    whole = Triple(*(np.rint(x * 2**15).astype(np.int64) for x in exact))
    integers = park(
        codes, clarke(codes, whole), Pair(*(np.rint(x * 2**15).astype(np.int64) for x in turn))
    )
    np.testing.assert_allclose(np.stack(integers) / 2**15, np.stack(wanted), atol=3e-5 * 3)


@pytest.mark.parametrize("o", [DOUBLES, SINGLES], ids=["double", "single"])
def test_inverses_undo_the_transforms(o: Floats) -> None:
    exact = Triple(*(x.astype(o.number) for x in phases(ANGLE, 1.0)))
    turn = Pair(o.number(math.cos(1.0)), o.number(math.sin(1.0)))
    back = clarke_inverse(o, park_inverse(o, park(o, clarke(o, exact), turn), turn))
    np.testing.assert_allclose(
        np.stack(back), np.stack(exact), atol=8 * float(np.finfo(o.number).eps)
    )


def test_transforms_of_phases_at_an_angle_are_the_two_steps_in_one() -> None:
    vector = np.random.default_rng(3).uniform(-5.0, 5.0, (2, ANGLE.size))
    found = dq_to_phases(vector[0], vector[1], ANGLE)
    steps = clarke_inverse(
        DOUBLES, park_inverse(DOUBLES, (vector[0], vector[1]), (np.cos(ANGLE), np.sin(ANGLE)))
    )
    np.testing.assert_allclose(found, np.stack(steps, axis=-1), atol=1e-14)
    np.testing.assert_allclose(np.stack(phases_to_dq(found, ANGLE)), vector, atol=1e-14)


def test_matrices_are_the_function_on_unit_vectors() -> None:
    orthogonal = clarke_matrix(power_invariant=True)
    np.testing.assert_allclose(orthogonal @ orthogonal.T, np.eye(3), atol=1e-15)
    np.testing.assert_allclose(clarke_matrix() @ np.ones(3), [0.0, 0.0, 1.0], atol=1e-15)


# The load angle of gdpwm is found otherwise in integers: tests/optimizer/fixed_control.
BY_VIEWS = tuple(name for name in FIXED_MODULATORS if MODULATORS[name].compared != "load angle")


@pytest.mark.parametrize("name", MODULATORS)
def test_every_arithmetic_finds_the_same_zero_sequence(name: ModulationName) -> None:
    """Voltages as shares of the dc link; currents lag by 20 degrees."""
    v, i = phases(ANGLE, 0.49), phases(ANGLE - math.radians(20.0), 0.7)
    wanted = modulate(name, np.stack(v, axis=-1), np.stack(i, axis=-1), 1.0).zero_sequence
    single_v, single_i = (Triple(*(x.astype(np.float32) for x in values)) for values in (v, i))
    vector = clarke(SINGLES, single_v)
    turn = load_turn(SINGLES, Pair, vector, clarke(SINGLES, single_i))
    delay = MODULATORS[name].delay
    if delay is not None:
        turn = Pair(*(np.full(ANGLE.size, x, dtype=np.float32) for x in delay))
    found = zero_sequence_of(
        SINGLES, name, single_v, single_i, np.array(1.0, dtype=np.float32), vector, turn
    )
    np.testing.assert_allclose(np.broadcast_to(found, ANGLE.shape), wanted, atol=1e-6)
    if name not in BY_VIEWS:
        return
    codes = Codes(Integers(), 16)
    whole_v, whole_i = (
        Triple(*(np.rint(x * 2**15).astype(np.int64) for x in values)) for values in (v, i)
    )
    integers = zero_sequence_of(codes, name, whole_v, whole_i, np.array(2**15))
    np.testing.assert_allclose(np.broadcast_to(integers, ANGLE.shape) / 2**15, wanted, atol=2e-4)


@pytest.mark.parametrize("name", BY_VIEWS)
def test_ranges_hold_every_integer(name: ModulationName) -> None:
    generator = np.random.default_rng(5)
    codes, ranges = Codes(Integers(), 16), Codes(Ranges(16), 16)
    v, i = (Triple(*generator.integers(-20_000, 20_001, (3, 2000))) for _ in range(2))
    every = Range(-20_000, 20_000)
    all_phases = Triple(every, every, every)
    hull = zero_sequence_of(ranges, name, all_phases, all_phases, Range(2**15, 2**15))
    found = zero_sequence_of(codes, name, v, i, np.array(2**15))
    assert hull.low <= int(np.min(found))
    assert int(np.max(found)) <= hull.high
    vector, turn = Pair(every, every), Pair(Range(-(2**15), 2**15 - 1), Range(-(2**15), 2**15 - 1))
    held = park(ranges, vector, turn)
    seen = park(codes, (v.a, v.b), (i.a, i.b))
    for hull, values in zip(held, seen, strict=True):
        assert hull.low <= int(np.min(values))
        assert int(np.max(values)) <= hull.high


def test_each_transform_is_defined_in_one_place() -> None:
    names = {"clarke", "clarke_inverse", "park", "park_inverse", "zero_sequence_of", "load_turn"}
    homes: dict[str, list[str]] = {name: [] for name in names}
    for floor in ("machines", "optimizer", "reports"):
        for path in (ROOT / floor).rglob("*.py"):
            source = path.read_text(encoding="utf-8")
            if not any(f"def {name}(" in source for name in names):
                continue
            # an arithmetic has methods of these names, by which steps call them
            for node in ast.parse(source).body:
                if isinstance(node, ast.FunctionDef) and node.name in names:
                    homes[node.name].append(path.stem)
    assert {name: len(found) for name, found in homes.items()} == dict.fromkeys(names, 1), homes
