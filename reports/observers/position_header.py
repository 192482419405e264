"""The C header of a position observer, as plain data and as text."""

from __future__ import annotations

import math
import re
import struct
from collections.abc import Mapping
from dataclasses import asdict
from textwrap import wrap
from typing import TYPE_CHECKING, Any

from dqforge.machines.errors import InputError
from dqforge.machines.records import dataclass
from dqforge.optimizer.observers.judgement import ANGLE_LIMIT, SPEED_LIMIT
from dqforge.reports.c_code.harness import Programme
from dqforge.reports.c_code.header_kind import SWEEP_POINTS, SWEEP_SEED
from dqforge.reports.c_code.title import title
from dqforge.reports.observers.float32_model import (
    gains_from,
    observer_inputs,
    observer_outputs,
    plain_gains_of,
)
from dqforge.reports.observers.training_text import bound_text, silence_text
from dqforge.reports.pages.templating import render
from dqforge.reports.steps.observer_text import observer_text

if TYPE_CHECKING:
    from dqforge.machines.design.design import Design
    from dqforge.optimizer.observers.method import ObserverMethod
    from dqforge.optimizer.observers.tuning import PositionObserver
    from dqforge.optimizer.observers.tuning_numbers import Disturbances
    from dqforge.reports.plain_data import PlainData

_PARAMETERS = (("R", "r_s"), ("L", "l_q"), ("psi", "psi_pm"))


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


def _span(low: float, high: float) -> str:
    if math.isnan(low):
        return "at no speed"
    return f"from {low / (2.0 * math.pi):.3g} to {high / (2.0 * math.pi):.3g} Hz (electrical)"


def speed_range_text(observer: PositionObserver) -> str:
    """Speeds at which the observer holds, accelerating and steady, in words."""
    judgement = observer.judgement
    limits = (
        f"errors below {math.degrees(ANGLE_LIMIT):.3g} deg and {100.0 * SPEED_LIMIT:.3g} % of the "
        "speed (r.m.s.)"
    )
    whole = _span(judgement.omega_low, judgement.omega_high)
    steady = _span(judgement.steady_low, judgement.steady_high)
    return f"{limits}: under acceleration {whole}, at constant speed {steady}"


def dead_time_text(known: Disturbances) -> str:
    """What of the dead time is judged, in words."""
    if known.lost == known.lost_least == 0.0:
        return "no dead time"
    if known.lost == -known.lost_least:
        return f"dead time wrong by {known.lost:.3g} V to either side"
    if known.lost_least < known.lost:
        return f"dead time wrong by {known.lost_least:.3g} to {known.lost:.3g} V"
    return f"dead time not compensated ({known.lost:.3g} V)"


def error_text(known: Disturbances, name: str) -> str:
    """By how much a parameter may be wrong: to either side, or from one figure to another."""
    least, most = known.limits(name)
    return (
        f"{100.0 * most:.3g} %"
        if most == -least
        else f"{100.0 * least:.3g} to {100.0 * most:.3g} %"
    )


def included_text(observer: PositionObserver) -> str:
    """What the errors of the stated range include, in words."""
    known = observer.disturbances
    parts = (
        ", ".join(f"{symbol} {error_text(known, name)}" for symbol, name in _PARAMETERS) + " wrong"
    )
    noise = f"noise of {known.i_noise:.3g} A and {known.v_noise:.3g} V r.m.s."
    if known.loads:
        pairs = dict.fromkeys(
            f"{load.i_d + 0.0:.3g}, {abs(load.i_q):.3g} A" for load in known.loads
        )
        loads = f"loads of (i_d, |i_q|) = {'; '.join(pairs)}, motoring and braking"
    else:
        loads = f"i_q = {known.i_load:.4g} A"
    return (
        f"{parts}; {dead_time_text(known)}; {noise}; {loads}; acceleration of "
        f"{known.acceleration:.3g} rad/s^2"
    )


def tuning_text(observer: PositionObserver) -> str:
    """By what numbers the observer was tuned, in words."""
    return observer.method.in_words(observer.tuning, observer.gains, observer.t_s)


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


def observer_body(method: ObserverMethod, gains: Any, prefix: str) -> str:
    """Types, functions and gains of a method; a learned correction is written around the flux
    observer.
    """
    from dqforge.optimizer.observers.methods.registry import METHODS

    macro = prefix.upper()
    if method.members is not None:
        return observer_text(method, gains, prefix, macro)
    context = {
        "prefix": prefix,
        "macro": macro,
        "code": method.code,
        "gains": asdict(gains),
        "flux": observer_text(METHODS["flux"], gains.flux, prefix, macro),
    }
    return render(f"observers/{method.code}.j2", context)


def observer_files(design: Design, observer: PositionObserver) -> dict[str, bytes]:
    """Name and bytes of the header of a position observer."""
    prefix = design.export.prefix
    context: PlainData = {
        **title(design),
        "preamble": _preamble(design, observer),
        "file": "observer",
        "kind": "position",
        "code": observer.method.code,
        "body": observer_body(observer.method, observer.gains, prefix),
    }
    return {f"{prefix}_observer.h": render("observers/observer.h.j2", context).encode("ascii")}


def observer_programme(observer: EmittedObserver) -> Programme:
    """The harness of a position observer, with what its model answers."""
    method, inputs = (
        observer.method,
        observer_inputs(observer.method, observer.gains, SWEEP_POINTS, SWEEP_SEED),
    )
    outputs = observer_outputs(method, observer.gains, inputs)
    return Programme(
        "observers/harness.c.j2", inputs, outputs, {"code": method.code}, name="position observer"
    )


def observer_gain_bytes(design: Design, observer: PositionObserver) -> bytes:
    """Bytes of ``<prefix>_<code>_gains_t`` on this machine: the numbers of the header, in its
    order, for runs that are given their own.
    """
    (content,) = observer_files(design, observer).values()
    values = content.decode("ascii").split("_GAINS = {", 1)[1].split("};", 1)[0]
    numbers = [float(number) for number in re.findall(r"-?[0-9.]+(?:e[+-]?[0-9]+)?(?=F)", values)]
    return struct.pack(f"={len(numbers)}f", *numbers)
