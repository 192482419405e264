"""A tracker of the position in C, from its step."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, cast

from dqforge.optimizer.observers.parts import FirmwareStep
from dqforge.optimizer.steps.step_arithmetic import AlphaBeta
from dqforge.reports.steps.blocks import Block, Functions
from dqforge.reports.steps.observer_text import step_text
from dqforge.reports.steps.record_text import c_name, record_structs, record_values, sentence
from dqforge.reports.steps.state_text import vector
from dqforge.reports.steps.step_reader import StepReader
from dqforge.reports.steps.symbols import Expression

if TYPE_CHECKING:
    from dqforge.machines.transforms import Reals
    from dqforge.optimizer.estimators import Signal, Tracker, TrackerSteps
    from dqforge.optimizer.observers.parts import ObserverState
    from dqforge.optimizer.steps.step_arithmetic import Arithmetic, Pair

_NAMES: dict[Signal, str] = {
    "sum-voltage": "u",
    "voltage-a": "v_a",
    "voltage-b": "v_b",
    "voltage-c": "v_c",
}


def tracker_text(tracker: Tracker, gains: Any, prefix: str, macro: str) -> str:
    """What stands in a header behind the types that control and observers share.

    Args:
        tracker: With ``members``; the C says of its functions what their docstrings begin with.
        gains: Its gains.
        prefix, macro: Before the names of functions and types, and before that of the gains.
    """
    if tracker.steps is not None:
        return _steps_text(tracker.code, tracker.steps(gains), gains, prefix, macro)
    assert tracker.members is not None

    def start(theta_e: Reals, omega_e: Reals) -> ObserverState:
        return cast("ObserverState", tracker.start(gains, theta_e, omega_e))

    def step(
        own: Any, state: ObserverState, v: Pair, i: Pair, o: Arithmetic, *heard: Reals
    ) -> ObserverState:
        return cast("ObserverState", tracker.step(own, state, v, i, heard, o))

    emitted = FirmwareStep(
        tracker.code,
        tracker.gains,
        start,
        step,
        tracker.members,
        sentence(tracker.start),
        sentence(tracker.step),
        tuple(_NAMES[signal] for signal in tracker.hears),
    )
    return step_text(emitted, gains, prefix, macro)


def _steps_text(code: str, steps: TrackerSteps, gains: Any, prefix: str, macro: str) -> str:
    """Macros, types, functions and gains of a tracker with a state of its own."""
    for kind, name in ((type(gains), f"{code}_gains"), (type(steps.state), code)):
        if c_name(kind) != name:
            raise ValueError(f"{kind.__name__} is not named like {code}")
    functions = Functions(names=steps.names)
    reader = StepReader(prefix, functions, Block("", set()))
    number = Expression("number")
    reader.write(f"{code}_start", steps.start, [steps.state, number, number])
    seen = [vector(AlphaBeta, name) for name in ("v", "i")]
    reader.write(f"{code}_step", steps.step, [gains, steps.state, *seen])
    parts = [
        [f"#define {macro}_{name} {value} /* {says} */" for name, value, says in steps.counts],
        *record_structs(gains, prefix, functions.members),
        *record_structs(steps.state, prefix),
        *([text] for text in functions.texts.values()),
        [
            f"static const {prefix}_{code}_gains_t {macro}_{code.upper()}_GAINS = {{",
            *record_values(gains, functions.members),
            "};",
        ],
    ]
    return "\n\n".join("\n".join(lines) for lines in parts)
