"""What a study can ask of each row: names, SI units, and the step that makes them.

Names are those of ``result.json`` where it says the same; points are counted from 0 in the order
of the design. Which names a study uses, and whether its design can give them, is checked here.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from typing import Literal, get_args

from dqforge.machines.design.design import Design
from dqforge.machines.design.settings import AnyStrategy, LoadPoint, LossStrategy, PhaseStrategy
from dqforge.machines.errors import InputError
from dqforge.machines.exploration.study import Bound, Study
from dqforge.machines.names import ModulationName
from dqforge.machines.places import KeyPath
from dqforge.machines.records import dataclass
from dqforge.machines.wording import close_matches, shown
from dqforge.optimizer.losses.budget_record import PARTS

# What is computed for an output: the largest torque, the current reference, the loops, the budget,
# or what a fixed header makes of the machine.
Step = Literal["limit", "fit", "current-loops", "speed-loop", "losses", "yields"]
LOOPS = ("i_d", "i_q", "speed")
FIT_PATHS = ("batch", "exact")
_LIMIT = {"torque_max": "N m", "i_d": "A", "i_q": "A"}

FIT_ERRORS: Mapping[str, str] = {
    "i_d": "A",
    "i_q": "A",
    "torque": "N m",
    "torque_relative": "",
    "loss": "W",
    "loss_relative": "",
}

LOOP_QUANTITIES: Mapping[str, str] = {
    "phase_margin": "rad",
    "gain_margin": "",
    "delay_margin": "s",
    "crossover": "rad/s",
    "max_sensitivity": "",
    "stable": "",
    "kp": "",
    "ki": "",
}

# Means over the points by their weights.
LOSS_POWERS: Mapping[str, str] = dict.fromkeys(
    ("total", *PARTS, "input_power", "shaft_power", "friction"),
    "W",
)

# Largest ones of the points.
LOSS_PEAKS: Mapping[str, str] = {
    "junction_temperature": "degC",
    "diode_temperature": "degC",
    "winding_temperature": "degC",
    "ripple_current": "A",
    "capacitor_current": "A",
    "voltage": "V",
    "voltage_error": "V",
}

LOSS_QUANTITIES: Mapping[str, str] = {**LOSS_POWERS, **LOSS_PEAKS}
_YIELDS = {"torque_error": "", "torque_made": "N m", "loss_penalty": ""}
_MODULATIONS: tuple[str, ...] = tuple(sorted(get_args(ModulationName)))
_STRATEGIES: tuple[str, ...] = tuple(sorted({*get_args(LossStrategy), *get_args(PhaseStrategy)}))
_POINT = re.compile(r"losses\.points\.(0|[1-9]\d{0,2})\.(?:([a-z0-9-]+)\.)?([a-z_]+)", re.ASCII)
_DEFAULT_MARGINS = tuple(name for name in LOOP_QUANTITIES if name not in ("kp", "ki"))


@dataclass(frozen=True, slots=True)
class PointOutput:
    """A quantity of the losses at one operating point: of the alternative that loses least there,
    or of the one with a ``modulation`` (empty: of any).
    """

    place: int
    modulation: str
    quantity: str


@dataclass(frozen=True, slots=True)
class Output:
    """One output.

    Args:
        name: As in the study; the column is ``out.<name>``.
        unit: SI unit, empty for numbers.
        step: What makes it.
        choices: Words of an output that is none of numbers, sorted.
        point: Of losses at a point: which one.
    """

    name: str
    unit: str
    step: Step
    choices: tuple[str, ...] = ()
    point: PointOutput | None = None

    @property
    def loop(self) -> str:
        """The loop it belongs to, empty for outputs of other steps and of all loops."""
        parts = self.name.split(".")
        return parts[1] if parts[0] == "gains" and len(parts) == 3 else ""

    @property
    def quantity(self) -> str:
        """Last part of the name."""
        return self.name.rpartition(".")[2]


def _plain_outputs() -> Iterator[Output]:
    for name, unit in _LIMIT.items():
        yield Output(f"reference.{name}", unit, "limit")
    for name, unit in FIT_ERRORS.items():
        yield Output(f"fit.error.{name}", unit, "fit")
    yield Output("fit.path", "", "fit", FIT_PATHS)
    yield Output("gains.phase_margin", "rad", "speed-loop")
    for loop in LOOPS:
        step: Step = "speed-loop" if loop == "speed" else "current-loops"
        for name, unit in LOOP_QUANTITIES.items():
            yield Output(f"gains.{loop}.{name}", unit, step)
    for name, unit in LOSS_QUANTITIES.items():
        yield Output(f"losses.{name}", unit, "losses")
    for name, unit in _YIELDS.items():
        yield Output(f"reference.{name}", unit, "yields")


_PLAIN: Mapping[str, Output] = {output.name: output for output in _plain_outputs()}


def output_named(name: str) -> Output | None:
    """The output of a name, None where there is none."""
    plain = _PLAIN.get(name)
    if plain is not None:
        return plain
    found = _POINT.fullmatch(name)
    if found is None or (found[2] is not None and found[2] not in _MODULATIONS):
        return None
    point = PointOutput(int(found[1]), found[2] or "", found[3])
    if point.quantity in LOSS_QUANTITIES:
        return Output(name, LOSS_QUANTITIES[point.quantity], "losses", point=point)
    words = {"modulation": _MODULATIONS, "strategy": _STRATEGIES}.get(point.quantity)
    return None if words is None else Output(name, "", "losses", words, point)


def known_names() -> tuple[str, ...]:
    """All names but those of single points, for lists and for what an unknown one may mean."""
    return tuple(_PLAIN)


def word_index(words: tuple[str, ...], word: AnyStrategy | ModulationName | str) -> int:
    """Place of a word in the sorted words of a choice."""
    return words.index(word)


def default_outputs(design: Design, *, header: bool) -> tuple[str, ...]:
    """What a study that names no outputs gets of a design: largest torque, errors of the fit,
    margins, losses and junction temperature of every point.

    Args:
        design: The design the study starts from, with what the study sets.
        header: Whether the study names a header: its torque, loss penalty and current loops are
            what is then judged on every machine, losses where the study names them.
    """
    if header:
        loops = [f"gains.{loop}.{name}" for loop in LOOPS[:2] for name in _DEFAULT_MARGINS]
        reference = [f"reference.{name}" for name in _YIELDS]
        return (*reference, *((*loops, "gains.phase_margin") if has_loops(design) else ()))
    names = ["reference.torque_max"]
    names += [f"fit.error.{name}" for name in ("i_d", "i_q", "torque", "torque_relative")]
    names.append("fit.path")
    names += _default_margins(design)
    names += _default_losses(design)
    return tuple(names)


def _default_margins(design: Design) -> list[str]:
    if not has_loops(design):
        return []
    loops = LOOPS if design.control.speed_loop is not None else LOOPS[:2]
    found = [f"gains.{loop}.{name}" for loop in loops for name in _DEFAULT_MARGINS]
    return [*found, "gains.phase_margin"]


def _default_losses(design: Design) -> list[str]:
    points = _points(design)
    if not points:
        return []
    device = design.inverter.device is not None
    quantities = ("total", "junction_temperature") if device else ("total",)
    found = [f"losses.{name}" for name in (*quantities, "ripple_current")]
    return found + [
        f"losses.points.{place}.{name}" for place in range(len(points)) for name in quantities
    ]


def has_loops(design: Design) -> bool:
    """Whether a design has loops with gains at all."""
    control = design.control
    return (
        control.gains != "none" and control.six_step is None and not control.current_loop.switches
    )


def _points(design: Design) -> tuple[LoadPoint, ...]:
    return () if design.losses is None else design.losses.points


def bound_output(bound: Bound, design: Design) -> str:
    """Name of the output that a bound looks at: that of its point where it names one.

    Raises:
        InputError: The design has no such point, or the output is none of single points.
    """
    if bound.point is None:
        return bound.output
    torque, omega_m, modulation = bound.point
    for place, point in enumerate(_points(design)):
        if _same(point.torque, torque) and _same(point.omega_m, omega_m):
            middle = f"{modulation}." if modulation else ""
            return f"losses.points.{place}.{middle}{bound.output.removeprefix('losses.')}"
    raise InputError(
        f"{bound.output}: the design has no point {torque:g} N m at {omega_m:g} rad/s; write it "
        "under losses.points, by set in the study"
    )


def _same(first: float, second: float) -> bool:
    return abs(first - second) <= 1e-9 * max(abs(first), abs(second))


def study_outputs(study: Study, design: Design) -> tuple[Output, ...]:
    """Outputs of a study in the order of their columns: those it lists or the default ones, then
    what its limits, acceptance, goals and sensitivities look at.

    Args:
        study: The study.
        design: The design it starts from, with what it sets.

    Raises:
        InputError: A name is none of an output, or the design cannot give it; with its place in the
            study.
    """
    header = bool(study.header)
    listed = study.outputs or default_outputs(design, header=header)
    found: dict[str, Output] = {}
    for section, name, path in _asked(study, listed, design):
        output = output_named(name)
        problem = _unknown(name) if output is None else _missing(output, design, header=header)
        if not problem and output is not None and output.choices and section != "outputs":
            problem = f"{shown(name)} is a word, no number; write it under outputs"
        if problem:
            raise _refusal(study, (section, path), problem)
        if output is not None:
            found.setdefault(name, output)
    return tuple(found.values())


def named_outputs(study: Study, design: Design) -> frozenset[str]:
    """Names that the study itself asks for, not by default.

    Args:
        study: The study.
        design: The design it starts from.
    """
    return frozenset(name for _, name, _ in _asked(study, study.outputs, design))


def _asked(study: Study, listed: tuple[str, ...], design: Design) -> Iterator[tuple[str, str, str]]:
    """Section, name of the output, and what the study calls it there."""
    for name in listed:
        yield "outputs", name, name
    sections: tuple[tuple[str, tuple[Bound, ...]], ...] = (
        ("limits", study.limits),
        ("accept", study.accept),
    )
    for section, bounds in sections:
        for bound in bounds:
            try:
                yield section, bound_output(bound, design), bound.output
            except InputError as error:
                words = error.message.removeprefix(f"{bound.output}: ")
                raise _refusal(study, (section, bound.output), words) from None
    for goal in study.goals:
        yield "pareto", goal.output, goal.output
    for name in study.sensitivity:
        yield "sensitivity", name, name


def _unknown(name: str) -> str:
    near = close_matches(name, known_names(), 1)
    hint = f"did you mean {near[0]}?" if near else "write e.g. reference.torque_max, losses.total"
    return f"{shown(name)} is no output; {hint}"


def _missing(output: Output, design: Design, *, header: bool) -> str:
    """Why a design cannot give an output, empty where it can."""
    if output.step == "yields" and not header:
        return "needs a fixed header; write header: nominal"
    if header and (output.step in ("limit", "fit") or output.quantity in ("kp", "ki")):
        return "is the same for every machine under a fixed header; leave header out"
    if header and output.loop == "speed":
        return f"a fixed header is judged by its current loops; write gains.i_q.{output.quantity}"
    if output.step in ("current-loops", "speed-loop"):
        return _missing_loop(output, design)
    if output.step == "losses":
        return _missing_losses(output, design)
    return ""


def _missing_loop(output: Output, design: Design) -> str:
    if not has_loops(design):
        return "the design has no current loops with gains; leave the output out"
    if output.loop == "speed" and design.control.speed_loop is None:
        quantity = output.quantity
        return f"the design has no speed loop; write gains.i_q.{quantity}"
    return ""


def _missing_losses(output: Output, design: Design) -> str:
    points = _points(design)
    if not points:
        return (
            "the design names no operating points; write set: {losses.points: "
            "[{torque: 1 N m, speed: 100 rad/s}]} in the study"
        )
    place = 0 if output.point is None else output.point.place
    if place >= len(points):
        return f"the design has {len(points)} operating points, counted from 0"
    if design.inverter.device is None and output.quantity in (
        "junction_temperature",
        "diode_temperature",
    ):
        return "the design names no inverter.device, so no junction has a temperature"
    return ""


def _refusal(study: Study, path: KeyPath, words: str) -> InputError:
    """An error on a key of the study, with its place."""
    message = f"{'.'.join(str(part) for part in path)}: {words}"
    if study.places is None:
        return InputError(message)
    line, column = study.places.of_key(path)
    return InputError(message, source=study.places.source, line=line, column=column)
