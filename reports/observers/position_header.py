"""The C headers of observers and trackers of the position, and of the speed observer: as plain
data, as text, and the run that proves each.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Mapping, Sequence
from textwrap import wrap
from typing import TYPE_CHECKING, Any

from dqforge.machines.errors import InputError
from dqforge.machines.records import dataclass
from dqforge.optimizer.estimators import TRACKERS, TunedTracker
from dqforge.optimizer.observers.reduced_order_step import SPEED_STEP, ReducedOrderGains
from dqforge.optimizer.observers.tuning import ObserverProof, PositionObserver
from dqforge.reports.c_code.harness import (
    SWEEP_POINTS,
    SWEEP_SEED,
    Constant,
    ConstantGroup,
    Harness,
    HeaderKind,
    Programme,
    observer_harness,
    title,
)
from dqforge.reports.capability import Capability, Outcome, Passage, ReportPart
from dqforge.reports.observers.float32_model import (
    EmittedTracker,
    gains_from,
    observer_inputs,
    observer_outputs,
    plain_gains_of,
    plain_speed_observer,
    speed_observer_from,
    speed_observer_inputs,
    speed_observer_outputs,
    tracker_inputs,
    tracker_outputs,
)
from dqforge.reports.observers.position_text import (
    bound_text,
    included_text,
    plain_proof,
    position_parts,
    proof_text,
    silence_text,
    speed_range_text,
    tuning_text,
)
from dqforge.reports.observers.speed_loop_text import (
    added_text,
    heard_text,
    speed_text,
    tracker_part,
    tuned_text,
)
from dqforge.reports.pages.html_text import (
    NARROW,
    NEGLIGIBLE,
    HtmlTable,
    Row,
    heading_cells,
    number,
    quantity,
    share,
    symbols,
)
from dqforge.reports.pages.templating import LOOPS, render
from dqforge.reports.steps.observer_text import observer_text, step_text, tracker_text

if TYPE_CHECKING:
    from dqforge.machines.design.design import Design
    from dqforge.optimizer.observers.parts import ObserverMethod
    from dqforge.optimizer.observers.reduced_order import (
        ErrorsAtLoad,
        ObserverError,
        ReducedOrderObserver,
    )
    from dqforge.optimizer.solution import Solution
    from dqforge.reports.plain_data import PlainData


@dataclass(frozen=True, slots=True)
class EmittedObserver:
    """What verification needs: the method and its gains (of the type ``method.gains``)."""

    method: ObserverMethod
    gains: Any


def emitted(observer: PositionObserver | None) -> EmittedObserver | None:
    """The part of a tuned observer that reaches the firmware."""
    return None if observer is None else EmittedObserver(observer.method, observer.gains)


def plain_observer(observer: EmittedObserver) -> PlainData:
    """Method and gains as plain data; every number is a float32 value."""
    return {"method": observer.method.name, "gains": plain_gains_of(observer.gains)}


def observer_from(plain: Mapping[str, Any]) -> EmittedObserver:
    """Read an observer back.

    Raises:
        InputError: The data are not what `plain_observer` makes.
    """
    from dqforge.optimizer.observers.methods.registry import METHODS

    method = METHODS.get(str(plain.get("method")))
    if method is None or not isinstance(plain.get("gains"), dict):
        raise InputError("observer_header is not what dqforge writes; run the design again")
    return EmittedObserver(method, gains_from(method.gains, plain["gains"]))


def _learned(observer: PositionObserver) -> list[str]:
    """What the correction can do, and where it does nothing."""
    if observer.training is None:
        return []
    bound, silence = bound_text(observer.training), silence_text(observer.training)
    return wrap(f"Correction: {bound}; {silence}.", 110)


def _preamble(design: Design, observer: PositionObserver) -> list[str]:
    code, prefix = observer.method.code, design.export.prefix
    return [
        f"Method: {observer.method.title}, sampled every {observer.t_s * 1e6:.6g} us.",
        *wrap(f"Tuning: {tuning_text(observer)}.", 110),
        *wrap(f"Range: {speed_range_text(observer)}.", 110),
        *wrap(f"Included: {included_text(observer)}.", 110),
        *_learned(observer),
        "",
        (
            f"Call {prefix}_{code}_start() once and {prefix}_{code}_step() at every sample with "
            "the voltage that acted"
        ),
        (
            "over the period that ends there. Compile with -ffp-contract=off to equal the model "
            "bit for bit."
        ),
    ]


def observer_files(design: Design, observer: PositionObserver) -> dict[str, bytes]:
    """Name and bytes of the header of a position observer."""
    prefix = design.export.prefix
    context: PlainData = {
        **title(design),
        "preamble": _preamble(design, observer),
        "file": "observer",
        "kind": "position",
        "code": observer.method.code,
        "body": observer_text(observer.method, observer.gains, prefix, prefix.upper()),
    }
    return {f"{prefix}_observer.h": render("observers/observer.h.j2", context).encode("ascii")}


def observer_programme(observer: EmittedObserver) -> Programme:
    """The harness of a position observer, with what its model answers."""
    method, inputs = (
        observer.method,
        observer_inputs(observer.method, observer.gains, SWEEP_POINTS, SWEEP_SEED),
    )
    outputs = observer_outputs(method, observer.gains, inputs)
    return Programme(position_harness(method.code), inputs, outputs, "position observer")


def position_harness(code: str) -> Harness:
    """What the header of a position observer does with a row."""
    return observer_harness("observer", code, "; angle and speed", 0, ("theta_e", "omega_e"))


def observer_gain_bytes(design: Design, observer: PositionObserver) -> bytes:
    """Bytes of ``<prefix>_<code>_gains_t`` on this machine: the numbers of the header, in its
    order, for runs that are given their own.
    """
    (content,) = observer_files(design, observer).values()
    values = content.decode("ascii").split("_GAINS = {", 1)[1].split("};", 1)[0]
    numbers = [float(number) for number in re.findall(r"-?[0-9.]+(?:e[+-]?[0-9]+)?(?=F)", values)]
    return struct.pack(f"={len(numbers)}f", *numbers)


# Trackers of the position.

_FAULT = InputError("observer_header is not what dqforge writes; run the design again")


def plain_tracker_gains(found: EmittedTracker) -> PlainData:
    """Method and gains as plain data; every number is a float32 value."""
    return {"method": found.tracker.name, "gains": plain_gains_of(found.gains)}


def tracker_from(plain: Mapping[str, Any]) -> EmittedTracker:
    """Read a tracker back.

    Raises:
        InputError: The data are not what `plain_tracker_gains` makes.
    """
    tracker = TRACKERS.get(str(plain.get("method")))
    if tracker is None or not isinstance(plain.get("gains"), dict):
        raise _FAULT
    return EmittedTracker(tracker, gains_from(tracker.gains, plain["gains"]))


def _tracker_preamble(design: Design, found: TunedTracker) -> list[str]:
    tracker, prefix = found.tracker, design.export.prefix
    call = (
        f"Call {prefix}_{tracker.code}_start() once and {prefix}_{tracker.code}_step() at every "
        f"sample with the voltage that acted over the period that ends there{heard_text(found)}. "
        "Compile with -ffp-contract=off to equal the model bit for bit."
    )
    return [
        f"Method: {tracker.title}, sampled every {found.t_s * 1e6:.6g} us.",
        *wrap(f"Tuning: {tuned_text(found)}.", 110),
        *wrap(f"Range: {speed_text(found)}.", 110),
        "",
        *wrap(call, 110),
        *wrap(added_text(found, prefix), 110),
    ]


def tracker_files(design: Design, found: TunedTracker, file: str = "observer") -> dict[str, bytes]:
    """Name and bytes of the header ``<prefix>_<file>.h`` of a tracker."""
    prefix, tracker = design.export.prefix, found.tracker
    context: PlainData = {
        **title(design),
        "preamble": _tracker_preamble(design, found),
        "file": file,
        "kind": "position",
        "code": tracker.code,
        "body": tracker_text(tracker, found.gains, prefix, prefix.upper()),
    }
    return {f"{prefix}_{file}.h": render("observers/observer.h.j2", context).encode("ascii")}


def tracker_programme(found: EmittedTracker, file: str = "observer") -> Programme:
    """The harness of a tracker in ``<prefix>_<file>.h``, with what its model answers."""
    inputs = tracker_inputs(found, SWEEP_POINTS, SWEEP_SEED)
    tracker = found.tracker
    told = f"{', further signals' if tracker.hears else ''}; angle and speed"
    results = ["theta_e", "omega_e"]
    if tracker.injects:
        told += ", the voltage that it asks for and the current that it hands on"
        results += ["added.alpha", "added.beta", "current.alpha", "current.beta"]
    rows = observer_harness(file, tracker.code, told, len(tracker.hears), tuple(results))
    return Programme(rows, inputs, tracker_outputs(found, inputs), "position tracker")


# Observers in the report.


def speed_tables(observer: ReducedOrderObserver, errors: Sequence[ErrorsAtLoad]) -> list[HtmlTable]:
    """Coefficients of the speed observer and its errors with and without load.

    ``errors`` are the steady errors of the speed: without load, and with half the largest torque.
    """
    return [_coefficients_table(observer), _speed_error_table(errors)]


def _coefficients_table(observer: ReducedOrderObserver) -> HtmlTable:
    coefficients = (
        ("A", f"{number(observer.a, 8)}", "pole in the z plane"),
        ("B_u", f"{number(observer.b_u, 8)}{NARROW}rad/(s V)", "factor of the voltage u_q"),
        ("B_i", f"{number(observer.b_i, 8)}{NARROW}rad/(s A)", "factor of the current i_q"),
        ("C", f"{number(observer.c, 8)}{NARROW}rad/(s A)", "current taken off the estimate"),
    )
    return HtmlTable(
        symbols(
            "Speed observer: \u03c9\u0302[k] = \u03b6[k] \u2212 C i_q[k], "
            "\u03b6[k+1] = A \u03b6[k] + B_u u_q[k] + B_i i_q[k]"
        ),
        ("", "", "value"),
        tuple(Row((symbols(name), symbols(text), value)) for name, value, text in coefficients),
        2,
    )


def _speed_error_table(errors: Sequence[ErrorsAtLoad]) -> HtmlTable:
    """Steady errors of the speed at half the base speed."""
    rows = []
    for label, found in zip(("no load", "half the largest torque"), errors, strict=True):
        cells = [_speed_error_text(error) for error in (found.exact, found.resistance)]
        rows.append(Row((label, quantity(found.torque_load, "N m"), *cells)))
    speed = quantity(errors[0].exact.omega_m, "rpm")
    caption = f"Steady speed error at {speed}, half the base speed, with an unknown load at i_d = 0"
    columns = (
        "",
        "load torque",
        "exact values",
        f"resistance {100.0 * errors[0].r_error:.0f} % too large",
    )
    return HtmlTable(symbols(caption), heading_cells(*columns), tuple(rows))


def estimator_tables(
    found: PositionObserver | TunedTracker, proof: ObserverProof | None = None
) -> list[HtmlTable]:
    """Of an observer or a tracker of the position."""
    if isinstance(found, PositionObserver):
        return position_tables(found, proof)
    title, columns, rows, notes = tracker_part(found)
    heading = symbols(f"{title}: {'; '.join(notes)}")
    return [HtmlTable(heading, heading_cells(*columns), tuple(Row(cells) for cells in rows))]


def position_tables(
    position: PositionObserver, proof: ObserverProof | None = None
) -> list[HtmlTable]:
    """Errors of a position observer over its speeds, with what they include and what is proven."""
    return [
        HtmlTable(
            symbols(f"{title}: {'; '.join(notes)}"),
            heading_cells(*columns),
            tuple(Row(cells) for cells in rows),
        )
        for title, columns, rows, notes in position_parts(position, proof)
    ]


def _speed_error_text(error: ObserverError) -> str:
    if abs(error.relative) < NEGLIGIBLE:
        return f"0{NARROW}rpm"
    return f"{quantity(error.total, 'rpm', 3)} ({share(error.relative, 2)})"


# The C header of the reduced-order speed observer (docs/methods/speed-observer.md).

REDUCED_ORDER = SPEED_STEP.code  # Part of the names of its C functions.


def speed_observer_files(design: Design, observer: ReducedOrderObserver) -> dict[str, bytes]:
    """Name and bytes of the header."""
    prefix, gains = design.export.prefix, ReducedOrderGains.of(design.machine, observer)
    context: PlainData = {
        **title(design),
        "file": "speed_observer",
        "kind": "speed",
        "preamble": [
            (
                f"Method: reduced-order observer, gain {observer.g:.6g} rad/s, sampled every "
                f"{observer.t_s * 1e6:.6g} us."
            ),
            (
                "It needs the angle, from an encoder or an observer of the position; it knows "
                "nothing of the load torque."
            ),
            "",
            (
                f"Call {prefix}_{REDUCED_ORDER}_start() once and {prefix}_{REDUCED_ORDER}_step() "
                "at every sample with the"
            ),
            "voltage that acted over the period that ends there.",
            "Compile with -ffp-contract=off to equal the model bit for bit.",
        ],
        "code": REDUCED_ORDER,
        "body": step_text(SPEED_STEP, gains, prefix, prefix.upper()),
    }
    return {
        f"{prefix}_speed_observer.h": render("observers/observer.h.j2", context).encode("ascii")
    }


def speed_observer_programme(gains: ReducedOrderGains) -> Programme:
    """The harness of a speed observer, with what its model answers."""
    inputs = speed_observer_inputs(gains, SWEEP_POINTS, SWEEP_SEED)
    outputs = speed_observer_outputs(gains, inputs)
    results = ("omega_m", "omega_e")
    rows = observer_harness("speed_observer", REDUCED_ORDER, ", angle; both speeds", 1, results)
    return Programme(rows, inputs, outputs, "speed observer")


# The C header ``<prefix>_observer.h`` of an observer or a tracker of the position: one of them.


def emitted_estimator(
    found: PositionObserver | TunedTracker,
) -> EmittedObserver | EmittedTracker:
    """What reaches the firmware."""
    if isinstance(found, TunedTracker):
        return EmittedTracker(found.tracker, found.gains)
    return EmittedObserver(found.method, found.gains)


def estimator_files(design: Design, found: PositionObserver | TunedTracker) -> dict[str, bytes]:
    """Name and bytes of the header."""
    if isinstance(found, TunedTracker):
        return tracker_files(design, found)
    return observer_files(design, found)


def plain_estimator(found: EmittedObserver | EmittedTracker) -> PlainData:
    """Method and gains as plain data."""
    if isinstance(found, EmittedTracker):
        return plain_tracker_gains(found)
    return plain_observer(found)


def estimator_from(plain: Mapping[str, Any]) -> EmittedObserver | EmittedTracker:
    """Read it back; errors as `observer_from`."""
    return tracker_from(plain) if plain.get("method") in TRACKERS else observer_from(plain)


def estimator_programme(found: EmittedObserver | EmittedTracker) -> Programme:
    """The harness, with what the model answers."""
    if isinstance(found, EmittedTracker):
        return tracker_programme(found)
    return observer_programme(found)


# Observers of position and of speed, as records.


def _part(tables: list[HtmlTable]) -> list[ReportPart]:
    return [Passage(tables=tables, kind="loops").of(LOOPS)]


def _position(outcome: Outcome) -> PositionObserver | TunedTracker | None:
    gains = outcome.solution.loops
    if gains is None:
        return None
    return gains.position if gains.tracker is None else gains.tracker


def _speed(outcome: Outcome) -> ReducedOrderObserver | None:
    gains = outcome.solution.loops
    return None if gains is None else gains.observer


POSITION_OBSERVER: Capability[PositionObserver | TunedTracker] = Capability(
    name="position_observer",
    title="position observer",
    of=_position,
    parts=lambda solution, observer: _part(estimator_tables(observer, solution.observer_proof)),
    headers=(
        HeaderKind(
            name="observer",
            files=lambda solution, observer: estimator_files(solution.design, observer),
            plain=lambda _, observer: plain_estimator(emitted_estimator(observer)),
            read=lambda own, _: estimator_from(own),
            programme=estimator_programme,
            vectors=False,
        ),
    ),
)

# Its words stand with those of the observer.
OBSERVER_PROOF = Capability(
    name="observer_proof",
    title="proof of the position observer",
    of=lambda outcome: outcome.solution.observer_proof,
    plain=lambda _, proof: plain_proof(proof),
    always=False,
    summary=lambda _, proof: [("observer", proof_text(proof))],
)

# Tables of the terminal and JSON of both stand with those of the loops.
SPEED_OBSERVER = Capability(
    name="speed_observer",
    title="speed observer",
    of=_speed,
    parts=lambda solution, observer: _part(speed_tables(observer, solution.observer_errors)),
    headers=(
        HeaderKind(
            name="speed_observer",
            files=lambda solution, observer: speed_observer_files(solution.design, observer),
            plain=lambda solution, observer: plain_speed_observer(
                solution.design.machine, observer
            ),
            read=lambda own, _: speed_observer_from(own),
            programme=speed_observer_programme,
            vectors=False,
        ),
    ),
)


# Constants of the speed observer for the main header.


def observer_constants(solution: Solution) -> list[ConstantGroup]:
    """The reduced-order speed observer; nothing without one."""
    observer = None if solution.loops is None else solution.loops.observer
    if observer is None:
        return []
    constants = (
        Constant("observer.a", observer.a, "", "pole in the z plane, dimensionless"),
        Constant("observer.b_u", observer.b_u, "rad/(s V)"),
        Constant("observer.b_i", observer.b_i, "rad/(s A)"),
        Constant("observer.c", observer.c, "rad/(s A)"),
    )
    comment = (
        "omega_hat[k] = zeta[k] - C i_q[k];  zeta[k+1] = A zeta[k] + B_U u_q[k] + B_I i_q[k]",
        "u_q = v_q - p omega_m L_D i_d, with the voltage that acts from sample k to k+1.",
        f"Continuous pole {observer.continuous_pole:.6g} 1/s; exact for held voltage.",
    )
    return [ConstantGroup("Reduced-order speed observer (mechanical speed)", constants, comment)]
