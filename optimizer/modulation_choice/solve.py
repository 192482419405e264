"""The choice of modulator and switching frequency that a design asks for: over its map, as rules,
and what they cost.

Of the best choice at every point of torque and speed a firmware can hold little. Trees of none, one
and two questions are found over a list of frequencies (`choice_rule`); then each answer takes the
one frequency with the least mean loss of its region that keeps all limits there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import BoolArray, FloatArray
from dqforge.machines.design.design import Design
from dqforge.machines.design.numerical import on_design
from dqforge.machines.design.settings import ChoiceSettings
from dqforge.machines.devices.inverter import Inverter
from dqforge.machines.dq_machines.synchronous import Machine
from dqforge.machines.errors import NoSolutionError
from dqforge.machines.losses.bridge_tables import bridge_tables
from dqforge.machines.names import ModulationName
from dqforge.machines.records import dataclass
from dqforge.optimizer.losses.drive_budget import BudgetOptions, DriveBudget, drive_budget
from dqforge.optimizer.losses.drive_comparison import strategy_currents, usable_limit
from dqforge.optimizer.modulation_choice.rule import (
    LIMITS,
    ROUNDING,
    ChoiceLimits,
    ChoicePoints,
    Leaf,
    Question,
    Rule,
    SimplifiedChoice,
    all_kept,
    electrical_frequency,
    frequency_marks,
    limit_marks,
    simplify,
)
from dqforge.optimizer.operating_points.characteristics import characteristics

_TRIED = 60  # Frequencies among which an answer finds its own.

# Switching frequencies of a rule are multiples of this in Hz, but for the ends of range and bands.
_STEP = 100.0


@dataclass(frozen=True, slots=True)
class PricedRule:
    """A rule over its own alternatives (modulator, switching frequency in Hz), and what it costs.

    ``taken`` is the alternative at each point of the map, shape (P,), -1 where the rule was not
    asked. ``mean_loss`` in W is over the points where it was; ``kept`` the share of these at which
    it keeps all limits.
    """

    questions: int
    rule: Rule
    alternatives: tuple[tuple[ModulationName, float], ...]
    taken: NDArray[np.intp]
    mean_loss: float
    kept: float

    @property
    def permitted(self) -> bool:
        """Whether it keeps all limits at every point."""
        return self.kept == 1.0


@dataclass(frozen=True, slots=True)
class ModulationChoice:
    """Best modulator and switching frequency over torque and speed, and rules that come close.

    Args:
        settings: What was asked for.
        torque, omega_m: Axes of the map in N m and rad/s, shapes (N,) and (M,); the points run row
            by row, P = N M.
        reached: Where some modulator makes the torque within current limit and linear range, shape
            (P,).
        best: Best choice at each point; without one where nothing keeps the limits.
        asked: Where the rules were asked: something that they may take keeps the limits, shape
            (P,).
        best_mean: Mean loss of the best choice over these points, in W.
        rules: With no, one and two questions.
        today: Modulator and switching frequency that the design has now, everywhere; its losses
            where they are known.
    """

    settings: ChoiceSettings
    torque: FloatArray
    omega_m: FloatArray
    reached: BoolArray
    best: BestChoice
    asked: BoolArray
    best_mean: float
    rules: tuple[PricedRule, ...]
    today: PricedRule

    @property
    def emitted(self) -> PricedRule:
        """The rule for the header."""
        return self.rules[self.settings.questions]

    @property
    def unreached_share(self) -> float:
        """Share of the map that lies beyond what current and voltage allow."""
        return float(np.mean(~self.reached))

    @property
    def idle_share(self) -> float:
        """Share of the map that can be reached, but where nothing keeps all limits."""
        return float(np.mean(self.reached & ~self.asked))

    @property
    def binding_shares(self) -> dict[str, float]:
        """Share of the points where the rules were asked at which each limit binds the best
        choice.
        """
        return {name: float(np.mean(mark[self.asked])) for name, mark in self.best.binding.items()}

    def price(self, rule: PricedRule) -> float:
        """What a rule costs above the best choice, relative to that."""
        return rule.mean_loss / self.best_mean - 1.0

    def simplified(self) -> SimplifiedChoice:
        """The rule for the header as `rule_header` takes it, priced against the best choice."""
        rule = self.emitted
        return SimplifiedChoice(rule.rule, rule.mean_loss, self.best_mean, rule.permitted)


@dataclass(frozen=True, slots=True)
class _Drive:
    """What every budget of the choice needs; ``points`` are those of the whole map."""

    design: Design
    limits: ChoiceLimits
    options: BudgetOptions
    names: tuple[ModulationName, ...]
    points: ChoicePoints

    def losses(
        self, frequencies: FloatArray, here: BoolArray, name: ModulationName | None = None
    ) -> _Losses:
        """Losses at some points, of one modulator or of all."""
        rows = slice(None) if name is None else [self.names.index(name)]
        currents = (values[rows][:, here] for values in (self.points.i_d, self.points.i_q))
        points = ChoicePoints(self.points.torque[here], self.points.omega_m[here], *currents)
        names = self.names if name is None else (name,)
        machine, inverter = self.design.machine, self.design.inverter
        loss, kept = permitted_losses(
            machine, inverter, points, names, frequencies, self.limits, options=self.options
        )
        return _Losses(loss, kept)


@dataclass(frozen=True, slots=True)
class _Losses:
    """Losses in W, and where the limits are kept, (M, F, P)."""

    loss: FloatArray
    kept: BoolArray


def choice_limits(settings: ChoiceSettings) -> ChoiceLimits:
    """Limits of a design's choice."""
    return ChoiceLimits(
        settings.f_min,
        settings.f_max,
        ripple_max=settings.ripple_max,
        junction_max=settings.junction_max,
        bands=settings.bands,
        carrier_ratio=settings.carrier_ratio,
    )


@on_design("modulation_choice")
def solve_choice(design: Design) -> ModulationChoice | None:
    """Choice of modulator and switching frequency of a design, None where it asks for none.

    Raises:
        NoSolutionError: At no point anything keeps the limits.
    """
    settings = design.modulation_choice
    if settings is None:
        return None
    torque, omega = _grid(design, settings)
    options = BudgetOptions(
        design.machine_loss,
        design.winding,
        design.inverter.capacitor_esr,
        settings.ripple_resistance,
    )
    # The modulator of today comes last: its currents are needed, too.
    today = design.operation.modulation
    names = (*settings.modulations, *(() if today in settings.modulations else (today,)))
    points, made = _points(design, settings, names, options, torque, omega)
    drive = _Drive(design, choice_limits(settings), options, names, points)
    count = len(settings.modulations)
    chosen_points = replace(points, i_d=points.i_d[:count], i_q=points.i_q[:count])
    best = best_choice(
        design.machine,
        design.inverter,
        chosen_points,
        settings.modulations,
        drive.limits,
        options=options,
    )
    asked, rules = _rules(drive, settings, best.found)
    mean = float(np.mean(best.loss[asked]))
    return ModulationChoice(
        settings=settings,
        torque=torque,
        omega_m=omega,
        # Without field weakening a torque within the current limit may still take too much voltage.
        reached=np.any(made[:count], axis=0) & (best.found | ~best.binding["voltage"]),
        best=best,
        asked=asked,
        best_mean=mean,
        rules=rules,
        today=_fixed(drive, (today, design.inverter.f_sw), asked),
    )


def _grid(design: Design, settings: ChoiceSettings) -> tuple[FloatArray, FloatArray]:
    """Torques up to the most that any modulator allows, and speeds.

    Both begin one step above zero.
    """
    widest = max(_limit(design, settings, name) for name in settings.modulations)
    figures = characteristics(design.machine, widest, design.i_max)
    torque = np.linspace(0.0, figures.torque_max, settings.torques + 1)[1:]
    return torque, np.linspace(0.0, settings.omega_m, settings.speeds + 1)[1:]


def _limit(design: Design, settings: ChoiceSettings, name: ModulationName) -> float:
    """Phase amplitude in V that a modulator makes at every frequency of the range,
    dead time made up for.
    """
    fastest = replace(design.inverter, f_sw=max(settings.f_max, design.inverter.f_sw))
    return usable_limit(fastest, name, design.operation.voltage_margin)


def _points(
    design: Design,
    settings: ChoiceSettings,
    names: tuple[ModulationName, ...],
    options: BudgetOptions,
    torque: FloatArray,
    omega: FloatArray,
) -> tuple[ChoicePoints, BoolArray]:
    """Points of the map with the currents (M, P) of every modulator, NaN where
    it cannot make the torque.
    """
    wanted, speed = (grid.ravel() for grid in np.meshgrid(torque, omega, indexing="ij"))
    limits = [_limit(design, settings, name) for name in names]
    found = {
        v_max: strategy_currents(
            design.machine,
            settings.strategy,
            wanted,
            speed,
            v_max=v_max,
            i_max=design.i_max,
            options=options,
        )
        for v_max in dict.fromkeys(limits)
    }
    made = np.stack([found[v_max][2] for v_max in limits])
    i_d, i_q = (
        np.where(made, np.stack([found[v_max][k] for v_max in limits]), np.nan) for k in range(2)
    )
    return ChoicePoints(wanted, speed, i_d, i_q), made


def _rules(
    drive: _Drive, settings: ChoiceSettings, found: BoolArray
) -> tuple[BoolArray, tuple[PricedRule, ...]]:
    """Where rules are asked, and those with no, one and two questions."""
    count = len(settings.modulations)
    frequencies = listed_frequencies(drive.limits, settings.frequencies)
    listed = drive.losses(frequencies, np.ones(found.shape, dtype=np.bool_))
    kept = listed.kept[:count].reshape(-1, found.size).T
    loss = listed.loss[:count].reshape(-1, found.size).T
    asked = found & np.any(kept, axis=1)
    if not np.any(asked):
        raise NoSolutionError(
            "modulation_choice: at no torque and speed a modulator and a switching frequency keep "
            "all limits; permit more ripple, a hotter junction or other frequencies"
        )
    alternatives = [(name, float(f)) for name in settings.modulations for f in frequencies]
    some = _undominated(np.where(kept, loss, np.inf)[asked])
    points = ChoicePoints(
        drive.points.torque[asked],
        drive.points.omega_m[asked],
        drive.points.i_d[0],
        drive.points.i_q[0],
    )
    rules = []
    for questions in range(3):
        simple = simplify(
            loss[asked][:, some], kept[asked][:, some], rule_quantities(points), questions=questions
        )
        rules.append(
            _refined(drive, simple.rule, [alternatives[k] for k in some], asked, questions)
        )
    return asked, tuple(rules)


def _undominated(loss: FloatArray) -> list[int]:
    """Alternatives, columns of (P, C) with inf where they are not permitted,
    that some other does not always beat.
    """
    some: list[int] = []
    for k in range(loss.shape[1]):
        mine = loss[:, k]
        earlier = np.any(np.all(loss[:, :k] <= mine[:, np.newaxis], axis=0))
        later = loss[:, k + 1 :]
        better = np.all(later <= mine[:, np.newaxis], axis=0) & np.any(
            later < mine[:, np.newaxis], axis=0
        )
        if not (earlier or np.any(better)):
            some.append(k)
    return some


def _refined(
    drive: _Drive,
    rule: Rule,
    alternatives: list[tuple[ModulationName, float]],
    asked: BoolArray,
    questions: int,
) -> PricedRule:
    """The rule with the best frequency for each of its answers, and its price."""
    taken = np.full(asked.shape, -1, dtype=np.intp)
    chosen: list[tuple[ModulationName, float]] = []
    known = rule_quantities(drive.points)

    def refine(node: Rule, here: BoolArray) -> Rule:
        if isinstance(node, Leaf):
            answer = _own_frequency(drive, alternatives[node.choice], here)
            if answer not in chosen:
                chosen.append(answer)
            taken[here] = chosen.index(answer)
            return Leaf(chosen.index(answer))
        above = known[node.quantity] >= np.float64(np.float32(node.threshold))
        below_rule, above_rule = refine(node.below, here & ~above), refine(node.above, here & above)
        if below_rule == above_rule:
            return below_rule
        return Question(node.quantity, node.threshold, below_rule, above_rule)

    found = refine(rule, asked)
    mean, kept = _price(drive, tuple(chosen), taken)
    return PricedRule(questions, found, tuple(chosen), taken, mean, kept)


def _own_frequency(
    drive: _Drive, listed: tuple[ModulationName, float], here: BoolArray
) -> tuple[ModulationName, float]:
    """The listed modulator at the frequency with the least mean loss over a region
    that keeps all limits there.
    """
    name, frequency = listed
    limits = drive.limits
    tried = np.round(np.geomspace(limits.f_min, limits.f_max, _TRIED) / _STEP) * _STEP
    tried = np.unique(
        np.concatenate([np.clip(tried, limits.f_min, limits.f_max), limits.edges(), [frequency]])
    )
    tried = tried[limits.outside_bands(tried)]
    if not np.any(here) or tried.size == 1:
        return listed
    found = drive.losses(tried, here, name)
    everywhere = np.all(found.kept[0], axis=1)
    if not np.any(everywhere):
        return listed
    mean = np.where(everywhere, np.mean(found.loss[0], axis=1), np.inf)
    return name, float(tried[np.argmin(mean)])


def _price(
    drive: _Drive, alternatives: tuple[tuple[ModulationName, float], ...], taken: NDArray[np.intp]
) -> tuple[float, float]:
    """Mean loss in W where something is taken, and the share of these points at
    which all limits are kept.
    """
    total, kept, count = 0.0, 0, 0
    for index, (name, frequency) in enumerate(alternatives):
        here = taken == index
        if np.any(here):
            found = drive.losses(np.array([frequency]), here, name)
            known = found.loss > 0.0
            total, count = total + float(np.sum(found.loss)), count + int(np.sum(known))
            kept += int(np.sum(found.kept))
    return (total / count if count else np.nan), kept / max(int(np.sum(taken >= 0)), 1)


def _fixed(
    drive: _Drive, alternative: tuple[ModulationName, float], asked: BoolArray
) -> PricedRule:
    """One alternative everywhere."""
    taken = np.where(asked, 0, -1)
    mean, kept = _price(drive, (alternative,), taken)
    return PricedRule(0, Leaf(0), (alternative,), taken, mean, kept)


# Which modulator and which switching frequency lose least at every operating point,
# and the rule that comes close.
#
# Loss over frequency is smooth: switching rises with it, ripple falls with its square, and
# temperatures tie both together. It is computed on a few frequencies, splined over their logarithm,
# and its least value sought on a fine grid within the limits, for all points and modulators at
# once.

_NODES = 13
_FINE = 193

# Frequencies per modulator that a rule may take, evenly in the logarithm, the ends of the range
# included.
_LISTED = 4

# Relative difference from which the losses of two modulators differ: less is rounding of the
# splines.
_EQUAL = 1e-6
_BINDS = 1e-4  # Relative saving from which a limit binds: less is the step of the frequency grid.
_AT_ONCE = 512  # Points whose curves are held in memory at once.


@dataclass(frozen=True, slots=True)
class BestChoice:
    """Best modulator and switching frequency per point, arrays of shape (P,) unless said otherwise.

    ``modulation`` is an index into ``modulations``, -1 where nothing keeps the limits; ``f_sw`` in
    Hz, ``loss`` in W, ``ripple_current`` in A (r.m.s.) and ``junction_temperature`` in degC belong
    to it, NaN where there is none. ``least`` holds the least loss of each modulator within the
    limits, shape (M, P), inf where it has none; of modulators that lose the same the first is
    taken. ``binding`` says for each of `LIMITS` where it costs: without it less could be lost, or
    something could be had at all.
    """

    modulations: tuple[ModulationName, ...]
    modulation: np.ndarray[tuple[int, ...], np.dtype[np.intp]]
    f_sw: FloatArray
    loss: FloatArray
    ripple_current: FloatArray
    junction_temperature: FloatArray
    least: FloatArray
    binding: dict[str, BoolArray]

    @property
    def found(self) -> BoolArray:
        """Where something keeps the limits."""
        return np.asarray(self.modulation >= 0)


def _splined(values: FloatArray, nodes: FloatArray, fine: FloatArray) -> FloatArray:
    """Values over frequency, (M, F, P), on finer frequencies, in the logarithm of both;
    NaN stays with its point.
    """
    from scipy.interpolate import CubicSpline

    usable = np.all(np.isfinite(values) & (values > 0.0), axis=1)
    safe = np.where(usable[:, np.newaxis], values, 1.0)
    found = np.exp(CubicSpline(np.log(nodes), np.log(safe), axis=1)(np.log(fine)))
    return np.where(usable[:, np.newaxis], found, np.nan)


def _budget(
    machine: Machine,
    inverter: Inverter,
    points: ChoicePoints,
    names: tuple[ModulationName, ...],
    frequencies: FloatArray,
    options: BudgetOptions | None,
) -> DriveBudget:
    return drive_budget(
        machine,
        inverter,
        points.i_d,
        points.i_q,
        points.omega_m,
        names,
        frequencies,
        options=options,
    )


@dataclass(frozen=True, slots=True)
class _Curves:
    """Loss in W, junction in degC and ripple in A at frequencies in Hz, all (M, F, P),
    and which limits are kept.
    """

    frequency: FloatArray
    loss: FloatArray
    hot: FloatArray
    ripple: FloatArray
    marks: dict[str, BoolArray]


def _curves(
    budget: DriveBudget,
    nodes: FloatArray,
    limits: ChoiceLimits,
    hottest: float,
    electrical: FloatArray,
) -> _Curves:
    """The budget on its nodes, carried over to a fine grid."""
    if nodes.size == 1:
        marks = limit_marks(budget, nodes, electrical, limits)
        frequency = np.broadcast_to(nodes[:, np.newaxis], budget.total.shape)
        return _Curves(
            frequency, budget.total, budget.junction_temperature, budget.ripple_current, marks
        )
    fine = np.union1d(np.geomspace(nodes[0], nodes[-1], _FINE), limits.edges())
    loss, hot = (
        _splined(values, nodes, fine) for values in (budget.total, budget.junction_temperature)
    )
    first = budget.ripple_current[:, 0] * nodes[0]  # ripple goes exactly as 1/f
    most = np.inf if limits.ripple_max is None else limits.ripple_max
    # The grid would round the least frequency that ripple and carrier ratio permit;
    # it stands behind it as it is.
    least = np.clip(np.fmax(first / most, limits.carrier_ratio * electrical), nodes[0], nodes[-1])
    shape = (loss.shape[0], fine.size, loss.shape[2])
    frequency = np.concatenate(
        [np.broadcast_to(fine[:, np.newaxis], shape), least[:, np.newaxis]], axis=1
    )
    loss, hot = (
        np.concatenate([values, _between(values, fine, least)], axis=1) for values in (loss, hot)
    )
    ripple = first[:, np.newaxis] / frequency
    # Between two nodes heat is steady where it is at the higher one.
    node = np.minimum(np.searchsorted(nodes, frequency * (1.0 - ROUNDING)), nodes.size - 1)
    marks = {
        "voltage": np.asarray((budget.linear & budget.known)[:, :1]),
        "ripple": np.asarray(ripple <= most * (1.0 + ROUNDING)),
        "junction": np.asarray(np.take_along_axis(budget.steady, node, axis=1) & (hot <= hottest)),
        **frequency_marks(frequency, electrical, limits),
    }
    return _Curves(frequency, loss, hot, ripple, marks)


def _between(values: FloatArray, fine: FloatArray, wanted: FloatArray) -> FloatArray:
    """Values (M, F, P) over fine frequencies at one of its own for each (M, P),
    straight in the logarithms.
    """
    after = np.clip(np.searchsorted(fine, wanted), 1, fine.size - 1)
    weight = np.log(wanted / fine[after - 1]) / np.log(fine[after] / fine[after - 1])
    low, high = (
        np.take_along_axis(values, place[:, np.newaxis], axis=1) for place in (after - 1, after)
    )
    return np.asarray(low * (high / low) ** weight[:, np.newaxis])


def _columns(points: ChoicePoints, here: slice) -> ChoicePoints:
    """Some of the points."""
    currents = (np.atleast_2d(values)[:, here] for values in (points.i_d, points.i_q))
    return ChoicePoints(points.torque[here], points.omega_m[here], *currents)


def best_choice(
    machine: Machine,
    inverter: Inverter,
    points: ChoicePoints,
    modulations: Sequence[ModulationName],
    limits: ChoiceLimits,
    *,
    options: BudgetOptions | None = None,
) -> BestChoice:
    """Modulator and switching frequency with the least total loss at P points.

    Args:
        machine, inverter, modulations, options: As in `drive_budget`.
        points: Where.
        limits: What is permitted.
    """
    names = tuple(modulations)
    nodes = np.geomspace(limits.f_min, limits.f_max, _NODES if limits.f_max > limits.f_min else 1)
    hottest = bridge_tables(inverter).max_junction_temperature
    hottest = hottest if limits.junction_max is None else min(hottest, limits.junction_max)
    parts = []
    for start in range(0, points.torque.size, _AT_ONCE):
        some = _columns(points, slice(start, start + _AT_ONCE))
        budget = _budget(machine, inverter, some, names, nodes, options)
        parts.append(
            _best(
                names, _curves(budget, nodes, limits, hottest, electrical_frequency(machine, some))
            )
        )
    whole = {
        name: np.concatenate([getattr(part, name) for part in parts], axis=-1)
        for name in (
            "modulation",
            "f_sw",
            "loss",
            "ripple_current",
            "junction_temperature",
            "least",
        )
    }
    binding = {name: np.concatenate([part.binding[name] for part in parts]) for name in LIMITS}
    return BestChoice(modulations=names, binding=binding, **whole)


def _best(names: tuple[ModulationName, ...], curves: _Curves) -> BestChoice:
    finite = np.isfinite(curves.loss)
    counted = np.where(all_kept(curves.marks) & finite, curves.loss, np.inf)
    least = np.min(counted, axis=1)
    smallest = np.min(least, axis=0)
    which = np.argmax(least <= smallest * (1.0 + _EQUAL), axis=0)
    column = np.arange(which.size)
    place = np.argmin(counted, axis=1)[which, column]
    found = np.isfinite(smallest)

    def taken(values: FloatArray) -> FloatArray:
        return np.where(found, values[which, place, column], np.nan)

    f_sw, ends = taken(curves.frequency), (np.min(curves.frequency), np.max(curves.frequency))
    ranged = bool(ends[0] < ends[1])
    binding = {
        "least frequency": found & (f_sw == ends[0]) & ranged,
        "largest frequency": found & (f_sw == ends[1]) & ranged,
    }
    for name in ("voltage", "ripple", "junction", "carrier ratio", "avoided band"):
        without = np.min(
            np.where(all_kept(curves.marks, name) & finite, curves.loss, np.inf), axis=(0, 1)
        )
        binding[name] = np.asarray(without < smallest * (1.0 - _BINDS))
    return BestChoice(
        modulations=names,
        modulation=np.where(found, which, -1),
        f_sw=f_sw,
        loss=taken(curves.loss),
        ripple_current=taken(curves.ripple),
        junction_temperature=taken(curves.hot),
        least=least,
        binding=binding,
    )


def permitted_losses(
    machine: Machine,
    inverter: Inverter,
    points: ChoicePoints,
    modulations: Sequence[ModulationName],
    frequencies: FloatArray,
    limits: ChoiceLimits,
    *,
    options: BudgetOptions | None = None,
) -> tuple[FloatArray, BoolArray]:
    """Total losses in W of every modulator at every frequency in Hz, and where all limits are kept,
    (M, F, P) each.

    The loss is 0 where it is not known. Parameters as in `best_choice`;
    ``frequencies`` has the shape (F,).
    """
    budget = _budget(machine, inverter, points, tuple(modulations), frequencies, options)
    kept = all_kept(limit_marks(budget, frequencies, electrical_frequency(machine, points), limits))
    return np.where(np.isfinite(budget.total), budget.total, 0.0), kept


def listed_frequencies(limits: ChoiceLimits, count: int = _LISTED) -> FloatArray:
    """Frequencies in Hz that a rule may take: even in the logarithm, to 100 Hz,
    with the ends of range and bands.
    """
    listed = np.round(np.geomspace(limits.f_min, limits.f_max, count), -2)
    found = np.unique(np.concatenate([np.clip(listed, limits.f_min, limits.f_max), limits.edges()]))
    return found[limits.outside_bands(found)]


def rule_quantities(points: ChoicePoints) -> dict[str, FloatArray]:
    """What a rule may ask about at the points, shape (P,) each."""
    return {"torque_Nm": np.abs(points.torque), "speed_rad_per_s": np.abs(points.omega_m)}
