"""What a paper leaves unstated, scanned: which choice explains numbers that do not agree.

A choice has a price, the numbers that were fitted to the print for it. Alternatives are ranked by
the printed numbers that they explain beyond those: a choice that explains no more than it was
fitted to explains nothing.
"""

from __future__ import annotations

import itertools
import math
import textwrap
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.synchronous import LinearMachine, linearised
from dqforge.machines.modulation.ripple import torque_spans
from dqforge.machines.names import ModulationName
from dqforge.machines.plants.scenario import Profile
from dqforge.machines.records import dataclass
from dqforge.machines.units.quantities import half_digit
from dqforge.optimizer.curves.fitting import chebyshev_nodes
from dqforge.optimizer.operating_points.mtpa_locus import (
    mtpa_currents,
    mtpa_per_unit,
    per_unit_base,
)
from dqforge.reports.pages.answer import Table
from dqforge.reports.papers.paper001_emitted_control import (
    BAND,
    TARGET,
    Constants,
    ProgramBench,
    codes_of,
    held_rpm,
)
from dqforge.reports.papers.transients import RPM, settled_or_nan
from dqforge.reports.plain_data import PlainData

_WIDTH = 118
_SHOWN = 8  # Alternatives in the table; plain data has all of them.


@dataclass(frozen=True, slots=True)
class Printed:
    """A printed number and how far from it, in its unit, what explains it may lie: half of its last
    digit, or what the words of the paper leave.
    """

    name: str
    unit: str
    value: float
    within: float


@dataclass(frozen=True, slots=True)
class Alternative:
    """What is assumed, how many numbers were fitted to the print for that, and what each printed
    number becomes with it; nan where it becomes nothing.
    """

    assumed: str
    fitted: int
    found: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Explanation:
    """Printed numbers and the alternatives, best first."""

    title: str
    printed: tuple[Printed, ...]
    alternatives: tuple[Alternative, ...]
    bounds: str

    def explained(self, alternative: Alternative) -> tuple[bool, ...]:
        """Whether each printed number follows."""
        return tuple(
            abs(found - of.value) <= of.within
            for found, of in zip(alternative.found, self.printed, strict=True)
        )

    def beyond(self, alternative: Alternative) -> int:
        """Printed numbers that it explains beyond those that it was fitted to."""
        return sum(self.explained(alternative)) - alternative.fitted

    def missed(self, alternative: Alternative) -> float:
        """Mean of the logarithm of how many tolerances a number is off, at least one."""
        off = [
            abs(found - of.value) / of.within
            for found, of in zip(alternative.found, self.printed, strict=True)
        ]
        return float(np.mean(np.log(np.maximum(np.nan_to_num(off, nan=1e6), 1.0))))

    def rank(self, alternative: Alternative) -> tuple[float, ...]:
        """The less the better: explained beyond what was fitted, then what is missed, then the
        numbers that were fitted.
        """
        return -self.beyond(alternative), self.missed(alternative), alternative.fitted

    @property
    def winner(self) -> Alternative:
        """The best one."""
        return self.alternatives[0]

    @property
    def as_good(self) -> tuple[Alternative, ...]:
        """Others that explain as much beyond what they were fitted to."""
        best = self.beyond(self.winner)
        return tuple(one for one in self.alternatives[1:] if self.beyond(one) == best)


def explain(
    title: str, printed: Sequence[Printed], alternatives: Iterable[Alternative], bounds: str
) -> Explanation:
    """Rank the alternatives, see `Explanation.rank`."""
    found = Explanation(title, tuple(printed), tuple(alternatives), bounds)
    return replace(found, alternatives=tuple(sorted(found.alternatives, key=found.rank)))


def explanation_table(found: Explanation) -> Table:
    """The first alternatives, and what the winner explains and misses."""
    few = len(found.printed) <= _SHOWN // 2
    rows = tuple(
        (
            one.assumed,
            str(one.fitted),
            f"{sum(found.explained(one))} of {len(found.printed)}",
            f"{found.beyond(one):+d}",
            *(f"{value:.4g}" for value in (one.found if few else ())),
        )
        for one in found.alternatives[:_SHOWN]
    )
    winner = found.winner
    judged = list(zip(found.printed, winner.found, found.explained(winner), strict=True))
    misses = [f"{of.name} {of.value:g} ({value:.4g})" for of, value, holds in judged if not holds]
    with_it = ", ".join(
        f"{of.name} {value:.4g} {of.unit}".strip() for of, value, holds in judged if holds
    )
    said = [
        f"Scanned: {found.bounds}, {len(found.alternatives)} alternatives.",
        f"Best: {winner.assumed}.",
        *([f"With it: {with_it}."] if not few and len(found.printed) <= _SHOWN else ()),
        f"Not explained by it: {', '.join(misses)}." if misses else "It explains all of them.",
        _as_good(len(found.as_good)),
    ]
    if found.beyond(winner) <= 0:
        said.append("None explains more numbers than it was fitted to: the question stays open.")
    heads = tuple(f"{of.name}, printed {of.value:g} {of.unit}" for of in found.printed)
    return Table(
        found.title,
        ("assumed", "numbers fitted", "explained", "beyond those fitted", *(heads if few else ())),
        rows,
        tuple(textwrap.wrap(" ".join(said), _WIDTH, break_on_hyphens=False)),
    )


def _as_good(others: int) -> str:
    if not others:
        return "No other is as good."
    return "As good: 1 other." if others == 1 else f"As good: {others} others."


def plain_explanation(found: Explanation) -> PlainData:
    """All of it as plain data."""
    return {
        "question": found.title,
        "bounds": found.bounds,
        "printed": [
            {"name": of.name, "unit": of.unit, "value": of.value, "within": of.within}
            for of in found.printed
        ],
        "alternatives": [
            {
                "assumed": one.assumed,
                "fitted": one.fitted,
                "explained": sum(found.explained(one)),
                "found": [value if math.isfinite(value) else None for value in one.found],
            }
            for one in found.alternatives
        ],
    }


# Paper 000, Table 2: nodes, breakpoints and base of the printed coefficients.

Coefficients = dict[tuple[str, int], tuple[tuple[float, ...], tuple[float, ...]]]
Breakpoints = Mapping[int, tuple[float, ...]]
Nodes = Callable[[int], FloatArray]

_END = 5.0  # Of the per-unit torque.
_PLACES = np.linspace(1.0, 3.4, 481)  # Breakpoints that are tried, in per unit.
_BASES = np.linspace(-0.01, 0.01, 21)  # By how much both bases may be off the identified ones.


def _stretched(count: int) -> FloatArray:
    nodes = chebyshev_nodes(count)
    return np.asarray(nodes / nodes[-1])


def _extrema(count: int) -> FloatArray:
    return -np.cos(np.pi * np.arange(count) / (count - 1))


_NODES: dict[str, Nodes] = {
    "Chebyshev nodes": chebyshev_nodes,
    "Chebyshev, stretched to both ends": _stretched,
    "Chebyshev extrema": _extrema,
    "equidistant with both ends": lambda count: np.linspace(-1.0, 1.0, count),
}


def interpolated(axis: str, nodes: Nodes, degree: int, edges: FloatArray) -> FloatArray:
    """Coefficients, highest power first, shape (N, n + 1), of the polynomials in per unit through
    the nodes between edges of shape (N, 2).
    """
    low, high = edges[:, :1], edges[:, 1:]
    places = 0.5 * (low + high) + 0.5 * (high - low) * nodes(degree + 1)
    values = mtpa_per_unit(places.ravel())["dq".index(axis)].reshape(places.shape)
    powers = places[..., np.newaxis] ** np.arange(degree, -1, -1)
    return np.asarray(np.linalg.solve(powers, values[..., np.newaxis])[..., 0])


def _printed_coefficients(printed: Coefficients) -> tuple[Printed, ...]:
    return tuple(
        Printed(
            f"c{degree - k} of i_{axis}, degree {degree}, segment {segment}",
            f"A/(N m)^{degree - k}",
            value,
            half_digit(value, 3),
        )
        for (axis, degree), rows in printed.items()
        for segment, row in enumerate(rows)
        for k, value in enumerate(row)
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Row:
    """One segment over nodes, bases and breakpoints, the printed breakpoint last.

    ``polynomials`` in per unit by kind of nodes, shape (P, n + 1), ``scale`` to A/(N m)^k by base,
    shape (B, n + 1), and ``held``, how many coefficients follow, shape (K, B, P).
    """

    polynomials: tuple[FloatArray, ...]
    scale: FloatArray
    held: NDArray[np.int8]

    def coefficients(self, kind: int, base: int, place: int) -> FloatArray:
        return np.asarray(self.polynomials[kind][place] * self.scale[base])


def _row(
    axis: str, segment: int, row: tuple[float, ...], places: FloatArray, bases: FloatArray
) -> _Row:
    degree = len(row) - 1
    ends = np.full_like(places, _END if segment else 0.0)
    edges = np.stack([places, ends] if segment else [ends, places], axis=1)
    made = tuple(interpolated(axis, nodes, degree, edges) for nodes in _NODES.values())
    scale = bases[:, :1] / bases[:, 1:] ** np.arange(degree, -1, -1)
    held = np.zeros((len(made), len(bases), places.size), dtype=np.int8)
    for kind, polynomials in enumerate(made):
        for k, value in enumerate(row):
            found = np.multiply.outer(scale[:, k], polynomials[:, k])
            held[kind] += np.abs(found - value) <= half_digit(value, 3)
    return _Row(made, scale, held)


def _best(pair: Sequence[_Row], kinds: list[int], base: int, breakpoints: str) -> FloatArray:
    """Coefficients of both segments of an axis that hold most of the printed ones, one after the
    other.
    """
    found = []
    held = [row.held[kinds, base] for row in pair]
    if breakpoints == "printed":
        places = [-1, -1]
    elif breakpoints == "shared":
        places = [int(np.argmax(sum(each.max(axis=0) for each in held)))] * 2
    else:
        places = [int(np.argmax(each.max(axis=0))) for each in held]
    for row, each, place in zip(pair, held, places, strict=True):
        kind = kinds[int(np.argmax(each[:, place]))]
        found.append(row.coefficients(kind, base, place))
    return np.concatenate(found)


def _most(pairs: Sequence[Sequence[_Row]], kinds: list[int], breakpoints: str) -> FloatArray:
    """How many coefficients hold by base, shape (B,)."""
    most = np.zeros(pairs[0][0].scale.shape[0])
    for pair in pairs:
        held = [row.held[kinds].max(axis=0) for row in pair]
        if breakpoints == "shared":
            most += (held[0] + held[1]).max(axis=1)
        else:
            most += sum(
                each[:, -1] if breakpoints == "printed" else each.max(axis=1) for each in held
            )
    return most


def explain_coefficients(
    machine: LinearMachine, printed: Coefficients, breakpoints: Breakpoints
) -> Explanation:
    """Table 2 over nodes, breakpoints and base: what the printed digits follow from.

    Args:
        machine: Identified from the table.
        printed: Both segments of each axis and degree, highest power first, in A/(N m)^k.
        breakpoints: In per unit of d and q, by degree.
    """
    base = per_unit_base(machine)
    around = [(0.0, 0.0), *itertools.product(_BASES, _BASES)]  # The identified one is first.
    bases = np.array([base.current, base.torque]) * (1.0 + np.array(around))
    pairs = [
        [
            _row(axis, k, row, np.append(_PLACES, breakpoints[degree]["dq".index(axis)]), bases)
            for k, row in enumerate(rows)
        ]
        for (axis, degree), rows in printed.items()
    ]
    each = len(pairs)
    nodes = [([k], name, 0) for k, name in enumerate(_NODES)]
    nodes.append((list(range(len(_NODES))), "the best nodes of each segment", 2 * each))
    edges = (
        ("printed", "printed breakpoints", 0),
        ("shared", "other breakpoints", each),
        ("own", "other ends of each segment", 2 * each),
    )
    alternatives = []
    for (kinds, said, first), (which, limits, second) in itertools.product(nodes, edges):
        most = _most(pairs, kinds, which)
        for best, words, third in (
            (0, "base as identified", 0),
            (int(np.argmax(most)), "base fitted", 2),
        ):
            found = np.concatenate([_best(pair, kinds, best, which) for pair in pairs])
            alternatives.append(
                Alternative(
                    f"{said}, {limits}, {words}", first + second + third, tuple(found.tolist())
                )
            )
    return explain(
        "Paper 000, Table 2: what its digits follow from",
        _printed_coefficients(printed),
        alternatives,
        "four kinds of nodes, breakpoints from 1 to 3.4 per unit, both bases within 1 %",
    )


# Paper 000, Figure 4: of what, where and by which polynomial its two printed figures are.

# "Maximum value of 1.09 A, a deviation of 1.53 % of the reference", of degree 2.
_FIGURE_4 = (
    Printed("largest error", "A", 1.09, 0.005),
    Printed("of the reference", "%", 1.53, 0.005),
)
_STATED_DEGREE = 2
_FIGURE_END, _STEP = 250.0, 0.1  # N m: of the figure's axis, and between the torques looked at
_LEAST_END = 100.0  # N m, of the ends that are tried
_SPLITS = np.linspace(1.0, 3.4, 49)  # Breakpoints that are tried, in per unit.
_ERRORS = ("i_d", "i_q", "|i_s|", "the vector (i_d, i_q)")


@dataclass(frozen=True, slots=True, eq=False)
class _Polynomials:
    """Both currents in A over the torque, shape (2, N), of which kind they are and how they were
    made, the numbers fitted for that, and where in N m their last breakpoint lies.
    """

    kind: str
    said: str
    fitted: int
    currents: FloatArray
    split: float


def _in_pieces(
    machine: LinearMachine, torque: FloatArray, nodes: Nodes, degree: int, splits: Sequence[float]
) -> FloatArray:
    """Currents in A over torques in N m, shape (2, N), with a breakpoint per axis in per unit."""
    base = per_unit_base(machine)
    x, rows = torque / base.torque, []
    for axis, split in zip("dq", splits, strict=True):
        edges = np.array([[0.0, split], [split, _END]]) if split else np.array([[0.0, _END]])
        pieces = interpolated(axis, nodes, degree, edges)
        first, last = np.polyval(pieces[0], x), np.polyval(pieces[-1], x)
        rows.append(base.current * np.where(x < split, first, last))
    return np.array(rows)


def _printed_pieces(
    machine: LinearMachine, torque: FloatArray, printed: Coefficients, breakpoints: Breakpoints
) -> Iterable[_Polynomials]:
    base = per_unit_base(machine).torque
    for degree, splits in breakpoints.items():
        rows = [
            np.where(torque < split * base, *(np.polyval(row, torque) for row in printed[at]))
            for at, split in zip((("d", degree), ("q", degree)), splits, strict=True)
        ]
        dear = int(degree != _STATED_DEGREE)
        said = f"printed coefficients of degree {degree}"
        yield _Polynomials(said, said, dear, np.array(rows), max(splits) * base)


def _tried_pieces(
    machine: LinearMachine, torque: FloatArray, breakpoints: Breakpoints
) -> Iterable[_Polynomials]:
    """All nodes and degrees, on the printed breakpoints, on none, and on those tried.

    Three nodes that include the ends are the same ones, however they are spread.
    """
    base = per_unit_base(machine).torque
    for (name, nodes), degree in itertools.product(_NODES.items(), breakpoints):
        before = list(_NODES.values())[: list(_NODES).index(name)]
        if any(np.allclose(other(degree + 1), nodes(degree + 1)) for other in before):
            continue
        said, dear = f"degree {degree}, {name}", int(degree != _STATED_DEGREE)
        whole = (
            (breakpoints[degree], "printed breakpoints", 0),
            ((0.0, 0.0), "one segment", 0),
        )
        tried = tuple(
            ((split, split), f"breakpoint {split:.2f}", 1) for split in _SPLITS.tolist() if not dear
        )
        for splits, words, fitted in (*whole, *tried):
            yield _Polynomials(
                said if fitted else f"{said}, {words}",
                f"{said}, {words}",
                dear + fitted,
                _in_pieces(machine, torque, nodes, degree, splits),
                max(splits) * base,
            )


def _shares(
    own: _Polynomials, exact: FloatArray, torque: FloatArray, slope: FloatArray, error: FloatArray
) -> dict[str, FloatArray]:
    """What the share in % is if the range ends at each torque, shape (N,), by what it is of.

    Args:
        own: The polynomials.
        exact: MTPA currents in A, shape (2, N).
        torque: In N m, shape (N,).
        slope: Relative error of the torque that the polynomials make, shape (N,).
        error: Of what is looked at, in A, with the reference of the same, shape (2, N).
    """
    gap, reference = error
    at, size = _places(gap), np.hypot(*exact)
    most = gap[at]
    beyond = torque >= own.split
    relative = np.where(beyond, gap / np.maximum(reference, 1e-9), 0.0)
    return {
        name: 100.0 * share
        for name, share in {
            "the reference there": most / np.maximum(reference[at], 1e-9),
            "|i_s| there": most / np.maximum(size[at], 1e-9),
            "the largest reference": most / np.maximum.accumulate(np.maximum(reference, 1e-9)),
            "the largest |i_s|": most / np.maximum.accumulate(np.maximum(size, 1e-9)),
            "the reference, largest beyond the breakpoints": np.maximum.accumulate(relative),
            "the torque there": slope[at],
            "the torque, largest beyond the breakpoints": np.maximum.accumulate(
                np.where(beyond, slope, 0.0)
            ),
        }.items()
    }


def _places(gap: FloatArray) -> NDArray[np.intp]:
    """Where the largest number up to each place is."""
    rises = gap >= np.maximum.accumulate(gap)
    return np.maximum.accumulate(np.where(rises, np.arange(gap.size), 0))


def _judged_errors(
    machine: LinearMachine, torque: FloatArray, exact: FloatArray, own: _Polynomials
) -> Iterable[tuple[str, Alternative]]:
    """What errs against the ``exact`` currents, and an alternative of it, for every share and
    end.
    """
    size = np.hypot(*exact)
    slope = np.abs(machine.torque(*own.currents) - torque) / np.maximum(torque, 1e-9)
    gaps = own.currents - exact
    errors = (
        (np.abs(gaps[0]), np.abs(exact[0])),
        (np.abs(gaps[1]), np.abs(exact[1])),
        (np.abs(np.hypot(*own.currents) - size), size),
        (np.hypot(*gaps), size),
    )
    stated = {f"to {_FIGURE_END:g} N m": _FIGURE_END, f"to {_END:g} per unit": float(torque[-1])}
    for what, error in zip(_ERRORS, errors, strict=True):
        largest = error[0][_places(error[0])]
        for of, share in _shares(own, exact, torque, slope, np.array(error)).items():
            said = f"{own.said}; {what}, % of {of}"
            ends = [
                (words, own.fitted, int(np.searchsorted(torque, end - 0.5 * _STEP)))
                for words, end in stated.items()
            ]
            if not own.fitted:
                k = _best_end(torque, largest, share)
                ends.append((f"to {torque[k]:.0f} N m", 1, k))
            for words, fitted, k in ends:
                found = (float(largest[k]), float(share[k]))
                yield what, Alternative(f"{said}; {words}", fitted, found)


def _best_end(torque: FloatArray, largest: FloatArray, share: FloatArray) -> int:
    """The end of the range at which both figures are least far from the print."""
    off = [
        np.log(np.maximum(np.abs(found - of.value) / of.within, 1.0))
        for found, of in zip((largest, share), _FIGURE_4, strict=True)
    ]
    missed = np.where(torque >= _LEAST_END, off[0] + off[1], np.inf)
    return int(np.argmin(missed))


def explain_largest_error(
    machine: LinearMachine, printed: Coefficients, breakpoints: Breakpoints
) -> Explanation:
    """Figure 4 over polynomials, what errs, what the share is of, and the end of the range.

    Args:
        machine, printed, breakpoints: As `explain_coefficients`.
    """
    best: dict[tuple[str, str], Alternative] = {}
    ranking = Explanation("", _FIGURE_4, (), "")
    last = _END * per_unit_base(machine).torque
    torque = np.linspace(0.0, last, round(last / _STEP) + 1)
    exact = np.array(mtpa_currents(machine, torque))
    polynomials = itertools.chain(
        _printed_pieces(machine, torque, printed, breakpoints),
        _tried_pieces(machine, torque, breakpoints),
    )
    for own in polynomials:
        for what, one in _judged_errors(machine, torque, exact, own):
            known = best.setdefault((own.kind, what), one)
            best[own.kind, what] = min(known, one, key=ranking.rank)
    return explain(
        "Paper 000, Figure 4: of what 1.09 A are 1.53 %",
        _FIGURE_4,
        best.values(),
        "printed coefficients, four kinds of nodes; degrees 2 to 4, others than the stated 2 at "
        "the price of a number; breakpoints printed, none, from 1 to 3.4 per unit; errors of i_d, "
        "i_q, |i_s|, the vector; shares of reference, |i_s|, torque; ends from 100 N m on, the "
        "best of each kind and error",
    )


# Paper 001, section 8.4: link voltage, inertia, friction and current limit of the runs shown.

_REVERSED, _ENDS = 1.2, 2.4  # s
_CLIMB, _UNREACHED = 2700.0, 4000.0  # rpm: Figures 8.14 to 8.17, and more than any voltage gives.

# "Around 400 ms", "practically the same"; the comment of the program on its limit of v_q.
_RUNS = (
    Printed("start to 1200 rpm", "s", 0.4, 0.06),
    Printed("reversal", "s", 0.4, 0.06),
    Printed("reversal over start", "", 1.0, 0.15),
    Printed("reached at a reference of 2700 rpm", "rpm", _CLIMB, 0.01 * _CLIMB),
    Printed("largest speed by the comment", "rpm", 2600.0, 50.0),
)

# What is assumed, its value, and how many numbers were fitted for it.
_LINKS = (
    ("214 V (back-EMF at 2600 rpm)", 214.0, 1),
    ("245 V", 245.0, 1),
    ("311 V (220 V rectified)", 311.0, 0),
)
_INERTIAS = (("inertia as printed", 1.0, 0), ("twice", 2.0, 1), ("three times", 3.0, 1))
_FRICTIONS = (("no friction", 0.0, 0), ("0.2 N m friction", 0.2, 1))
_LIMITS = (
    ("limit 32000", 12.5, 0),
    ("3 A", 3.0, 1),
    ("2.5 A", 2.5, 1),
)


def explain_transients(place: ProgramBench) -> Explanation:
    """Start, reversal and largest speed over what the thesis does not state, with its program's
    integers in the loop.
    """
    reversal = Profile((0.0, _REVERSED), (TARGET * RPM, -TARGET * RPM))
    climb = Profile((0.0, 0.3), (TARGET * RPM, _UNREACHED * RPM))
    plant, alternatives = place.drive, []
    linear, own = linearised(plant.machine), plant.machine.inertia or math.nan
    for (v_words, v_dc, v_fitted), (f_words, friction, f_fitted) in itertools.product(
        _LINKS, _FRICTIONS
    ):
        supplied = replace(plant, inverter=replace(plant.inverter, v_dc=v_dc))
        free = replace(place, drive=supplied).run(1.5, climb, friction=friction)
        most = float(np.mean(free.omega_m[free.t >= 1.4])) / RPM
        reached = min(most, held_rpm(_CLIMB))
        for (j_words, inertia, j_fitted), (i_words, limit, i_fitted) in itertools.product(
            _INERTIAS, _LIMITS
        ):
            machine = replace(linear, inertia=inertia * own)
            found = replace(place, drive=replace(supplied, machine=machine)).run(
                _ENDS, reversal, Constants(max_w=codes_of(limit)), friction=friction
            )
            start = settled_or_nan(found, 0.0, _REVERSED, TARGET * RPM, BAND)
            back = settled_or_nan(found, _REVERSED, _ENDS, -TARGET * RPM, BAND)
            alternatives.append(
                Alternative(
                    f"{v_words}; {j_words}; {f_words}; {i_words}",
                    v_fitted + j_fitted + f_fitted + i_fitted,
                    (start, back, back / start, reached, most),
                )
            )
    return explain(
        "Paper 001, section 8.4 and Figures 8.14 to 8.17: what times and speed follow from",
        _RUNS,
        alternatives,
        "link voltage; inertia; dry friction (0.2 N m); limit of the current (32000 are 12.5 A)",
    )


# Paper 000, Table 4: slots beside the switching, in the largest torque ripple.

_ORDERS, _PHASES = (6, 12, 18, 24), 24
_HALF_DIGIT = 0.005  # N m, of the printed ripple.
_SLOT_TORQUES = np.linspace(0.0, 4.0, 801)  # N m, amplitudes that are tried.


@dataclass(frozen=True, slots=True)
class RippleColumn:
    """A column of the table: modulator, currents in A (peak), printed torque ripple in N m."""

    name: str
    modulation: ModulationName
    i_d: float
    i_q: float
    printed: float


def _slot_sizes(psi: complex, i: complex) -> dict[str, float]:
    """What the amplitude of the slots' torque is proportional to, by its words."""
    return {
        "the same everywhere": 1.0,
        "as |psi|": abs(psi),
        "as |psi|^2": abs(psi) ** 2,
        "as psi_d": psi.real,
        "as i_q": i.imag,
        "as |i|": abs(i),
    }


def explain_ripple(
    machine: LinearMachine,
    columns: Sequence[RippleColumn],
    omega_m: float,
    *,
    v_dc: float,
    f_sw: float,
) -> Explanation:
    """Slots whose torque turns with the rotor, beside the switching at each of its angles.

    Args:
        machine: The machine of the table.
        columns: Its columns.
        omega_m: Speed in rad/s (mechanical).
        v_dc, f_sw: DC-link voltage in V and carrier frequency in Hz.
    """
    theta = np.linspace(0.0, 2.0 * math.pi, 360, endpoint=False)
    printed = tuple(Printed(of.name, "N m", of.printed, _HALF_DIGIT) for of in columns)
    ranking = Explanation("", printed, (), "")
    spans, sizes = [], []
    for of in columns:
        i_d, i_q = np.array([of.i_d]), np.array([of.i_q])
        omega_e = np.array([machine.pole_pairs * omega_m])
        made = np.stack(machine.voltage(i_d, i_q, omega_e))
        at = np.stack([i_d, i_q]), made, theta[None]
        span = torque_spans(of.modulation, machine, *at, v_dc=v_dc, t_s=1.0 / f_sw)
        spans.append(span[0])
        psi_d, psi_q = machine.flux(i_d, i_q)
        sizes.append(_slot_sizes(complex(psi_d[0], psi_q[0]), complex(of.i_d, of.i_q)))
    best: dict[tuple[str, str], Alternative] = {}
    for place, turns, fitted, curves in _slot_curves(theta, np.stack(spans)):
        for words in sizes[0]:
            one = _fitted_slots(curves, [size[words] for size in sizes], columns)
            said = Alternative(f"slots {words}; {turns}", 1 + fitted, one)
            known = best.setdefault((words, place), said)
            best[words, place] = min(known, said, key=ranking.rank)
    return explain(
        "Paper 000, Table 4: the torque ripple with slots beside the switching",
        printed,
        best.values(),
        "one amplitude, fitted to the column that suits best, at constant currents; its law over "
        "flux linkages and currents; extremes of slots and switching that meet (any high order), "
        "or order 6, 12, 18, 24 with a fitted angle",
    )


def _slot_curves(
    theta: FloatArray, spans: FloatArray
) -> Iterator[tuple[str, str, int, FloatArray]]:
    """Kind, words, numbers fitted, and peak to peak over the amplitudes (columns, 801), for spans
    of the switching (columns, angles).
    """
    together = 2.0 * _SLOT_TORQUES + np.max(spans, axis=1)[:, None]
    yield "meet", "extremes meet", 0, together
    for order, phase in itertools.product(_ORDERS, range(_PHASES)):
        wave = _SLOT_TORQUES[:, None] * np.cos(order * theta + phase * 2.0 * math.pi / _PHASES)
        high = np.max(wave + 0.5 * spans[:, None], axis=2)
        low = np.min(wave - 0.5 * spans[:, None], axis=2)
        words = f"order {order} at {phase * 360 / _PHASES / order:.3g} deg"
        yield f"order {order}", words, 1, high - low


def _fitted_slots(
    curves: FloatArray, sizes: Sequence[float], columns: Sequence[RippleColumn]
) -> tuple[float, ...]:
    """Peak to peak of each column, with the amplitude of the column that leaves least in all."""
    found = []
    for curve, size, of in zip(curves, sizes, columns, strict=True):
        for fitted in of.printed + _HALF_DIGIT * np.array([0.0, -0.9, -0.5, 0.5, 0.9]):
            factor = float(np.interp(fitted, curve, _SLOT_TORQUES)) / size
            found.append(
                tuple(
                    float(np.interp(factor * own, _SLOT_TORQUES, other))
                    for own, other in zip(sizes, curves, strict=True)
                )
            )

    def missed(values: tuple[float, ...]) -> tuple[int, float]:
        off = [abs(value - of.printed) for value, of in zip(values, columns, strict=True)]
        return -sum(miss <= _HALF_DIGIT for miss in off), max(off)

    return min(found, key=missed)
