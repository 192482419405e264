"""Drawn values of a study: row k of a key depends on the seed, the key and k alone.

A batch may begin anywhere, a longer study keeps its rows, and with ``random`` sampling another key
leaves the others as they are. Points of a Sobol sequence are those of all drawn keys together.
"""

from __future__ import annotations

import hashlib
import warnings
from collections.abc import Mapping, Sequence

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.exploration.study import Draw, Tolerance
from dqforge.optimizer.exploration.saltelli_design import saltelli_inputs, saltelli_places

_PER_STEP = 4  # Numbers of 64 bits that Philox gives for one step of its counter.
_STEP = 0.5**53
# Random numbers lie in the middle of steps of this width, so that none is 0 or 1.
_HALF = 0.5 * _STEP

# What the library's forward jump can do; a point lies in the middle of its step here, too.
_BITS = np.uint64(11)
_BITS_OF_SOBOL = 32


def draw_values(
    draw: Draw, tolerances: Sequence[Tolerance], first: int, end: int, *, saltelli: bool = False
) -> dict[str, FloatArray]:
    """Values of every drawn key in SI units, shape (end - first,), for draws first to end - 1.

    With ``saltelli`` they are those of a design for sensitivities, keys in alphabetical order.
    """
    keys = [tolerance.key for tolerance in tolerances]
    if saltelli:
        shares = _saltelli_shares(draw, keys, first, end)
    else:
        shares = draw_shares(draw, keys, first, end)
    return {tolerance.key: values_at(tolerance, shares[tolerance.key]) for tolerance in tolerances}


def draw_shares(draw: Draw, keys: Sequence[str], first: int, end: int) -> dict[str, FloatArray]:
    """Shares of the distribution below each value, uniform in (0, 1), by key, shape (end - first,).

    Correlated keys are so in their normal scores; without correlations keys are independent.
    """
    ordered = sorted(keys)
    if draw.sampling == "sobol":
        points = _sobol(draw.seed, len(ordered), first, end)
        shares = {key: points[:, place] for place, key in enumerate(ordered)}
    else:
        shares = {key: _philox(draw.seed, key, first, end) for key in ordered}
    return shares | _correlated(draw, shares) if draw.correlations else shares


def _saltelli_shares(
    draw: Draw, keys: Sequence[str], first: int, end: int
) -> dict[str, FloatArray]:
    """Shares as `draw_shares`, of rows whose base rows are points of a Sobol sequence."""
    ordered = sorted(keys)
    base, which = saltelli_places(first, end, len(ordered))
    begin, last = int(base[0]), int(base[-1])
    points = _sobol(draw.seed, 2 * len(ordered), begin, last + 1)
    shares = saltelli_inputs(points[base - begin], which)
    return {key: shares[:, place] for place, key in enumerate(ordered)}


def _philox(seed: int, key: str, first: int, end: int) -> FloatArray:
    """Uniform numbers first to end - 1 of the stream of a key."""
    stream = int.from_bytes(hashlib.sha256(key.encode()).digest()[:8], "little")
    # The high word of the key of the generator is the stream, the low one the seed.
    generator = np.random.Philox(key=(stream << 64) | seed)
    step, over = divmod(first, _PER_STEP)
    generator.advance(step)
    raw = np.asarray(generator.random_raw(end - first + over), dtype=np.uint64)[over:]
    return (raw >> _BITS).astype(np.float64) * _STEP + _HALF


def _sobol(seed: int, count: int, first: int, end: int) -> FloatArray:
    """Points of a scrambled Sobol sequence, shape (end - first, count)."""
    from scipy.stats.qmc import Sobol

    sequence = Sobol(count, scramble=True, rng=np.random.default_rng(seed), bits=_BITS_OF_SOBOL)
    with warnings.catch_warnings():
        # That the number of points is no power of 2 is meant: a study takes them in batches.
        warnings.simplefilter("ignore", UserWarning)
        if first:
            sequence.fast_forward(first)
        points = np.asarray(sequence.random(end - first), dtype=np.float64)
    return points + 0.5 ** (_BITS_OF_SOBOL + 1)


def _correlated(draw: Draw, shares: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
    """Shares of the keys that correlations name, by Cholesky's factor on their normal scores."""
    from scipy.special import ndtr, ndtri

    found: dict[str, FloatArray] = {}
    for keys in _groups(draw):
        matrix = np.eye(len(keys))
        for one, other, rho in draw.correlations:
            if one in keys:
                places = keys.index(one), keys.index(other)
                matrix[places] = matrix[places[::-1]] = rho
        factor = np.linalg.cholesky(matrix)
        scores = [ndtri(shares[key]) for key in keys]
        for place, key in enumerate(keys[1:], 1):
            # Summed term by term: a product of matrices depends on the number of rows.
            mixed = sum(factor[place, other] * scores[other] for other in range(place + 1))
            found[key] = np.clip(ndtr(mixed), _HALF, 1.0 - _STEP)
    return found


def _groups(draw: Draw) -> list[list[str]]:
    """Keys that hang together by correlations, each group and all groups in alphabetical order."""
    groups: list[set[str]] = []
    for one, other, _ in draw.correlations:
        joined = {one, other}
        apart = []
        for group in groups:
            if group & joined:
                joined |= group
            else:
                apart.append(group)
        groups = [*apart, joined]
    return sorted(sorted(group) for group in groups)


def values_at(tolerance: Tolerance, share: FloatArray) -> FloatArray:
    """Values in SI units below which a share of the distribution lies, shape of ``share``."""
    if tolerance.kind == "between":
        return tolerance.low + share * (tolerance.high - tolerance.low)
    scale = tolerance.width * (tolerance.centre if tolerance.relative else 1.0)
    if tolerance.kind == "uniform":
        return tolerance.centre + scale * (2.0 * share - 1.0)
    from scipy.special import ndtr, ndtri

    below = float(ndtr(-tolerance.cut))
    score = np.asarray(ndtri(below + share * (1.0 - 2.0 * below)), dtype=np.float64)
    return tolerance.centre + scale * np.clip(score, -tolerance.cut, tolerance.cut)
