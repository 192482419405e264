"""What in the macros of ST's MCSDK does not fit together, and what does not fit 16 bits."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace

from dqforge.optimizer.firmware.configuration import OwnValue
from dqforge.optimizer.firmware.own_values import number
from dqforge.optimizer.firmware.st_format.st_gains import shift
from dqforge.optimizer.firmware.st_format.st_mtpa import (
    SEGMENTS,
    MtpaTable,
    best_linear_machine,
)
from dqforge.optimizer.firmware.st_format.st_observer import (
    constants,
    observed_machine,
    observer_integers,
    placed_poles,
)
from dqforge.optimizer.firmware.st_format.st_scales import (
    FULL,
    LARGEST,
    control_rate,
    current_scale,
    integers,
)

_STEP = 10  # Counts of d current from which on a step between segments is told.
_ROUNDED = 2e-3  # Relative error of inputs that files print rounded.


def contradictions(own: Mapping[str, OwnValue]) -> tuple[str, ...]:
    """One sentence each, with both numbers."""
    return (
        *_gains(own, "TORQUE"),
        *_gains(own, "FLUX"),
        *_dividers(own),
        *_currents(own),
        *_observer(own),
        *_table(own),
    )


def _gains(own: Mapping[str, OwnValue], axis: str) -> Iterator[str]:
    """Whether ki/kp is R/L, to one count in either and what rounded inputs leave open."""
    kp, ki = number(own, f"PID_{axis}_KP_DEFAULT"), number(own, f"PID_{axis}_KI_DEFAULT")
    kp_divider, ki_divider = number(own, "TF_KPDIV"), number(own, "TF_KIDIV")
    r_s, inductance, rate = number(own, "RS"), number(own, "LS"), control_rate(own)
    if axis == "FLUX" and inductance is not None:
        inductance *= number(own, "ld_lq_ratio") or 1.0
    if not kp or ki is None or not kp_divider or not ki_divider:
        return
    if r_s is None or not inductance or rate is None:
        return
    wanted = kp / shift(kp_divider) * r_s / (inductance * rate) * shift(ki_divider)
    room = 1.0 + wanted * (_ROUNDED + 1.0 / kp)
    if abs(ki - wanted) > room:
        yield (
            f"PID_{axis}_KI_DEFAULT {ki:g} is not R/(L f) of PID_{axis}_KP_DEFAULT {kp:g} = "
            f"{wanted:.1f} counts, Workbench's rule: chosen by another one, edited by hand, or R "
            "or L measured again"
        )


def _dividers(own: Mapping[str, OwnValue]) -> Iterator[str]:
    for name in ("TF_KPDIV", "TF_KIDIV", "SP_KPDIV", "SP_KIDIV"):
        value = number(own, name)
        if value is not None and not math.log2(max(value, 0.5)).is_integer():
            yield (
                f"{name} {value:g} is no power of two, of which the firmware takes the logarithm: "
                f"it divides by {shift(value):.0f}"
            )


def _currents(own: Mapping[str, OwnValue]) -> Iterator[str]:
    full = current_scale(own)
    for name in ("NOMINAL_CURRENT_A", "IQMAX_A", "ID_DEMAG_A"):
        value = number(own, name)
        if value is not None and full is not None and abs(value) > full * LARGEST / FULL:
            yield (
                f"{name} {value:g} A is beyond the full scale of the current measurement, "
                f"{full:.4g} A"
            )


def _table(own: Mapping[str, OwnValue]) -> Iterator[str]:
    """Steps between the segments of a table, which the best table hardly has."""
    width, full = number(own, "SEGDIV"), current_scale(own)
    slopes, offsets = integers(own.get("ANGC")), integers(own.get("OFST"))
    if not width or slopes is None or offsets is None or len(slopes) != len(offsets):
        return
    largest = own_counts(own, full) or min(LARGEST, int(width) * SEGMENTS - 1)
    whole = MtpaTable(int(width), slopes, offsets, largest, 0.0, 0)
    if len(slopes) != SEGMENTS or whole.largest < SEGMENTS:
        return
    found = best_linear_machine(whole)
    if found.jump < _STEP:
        return
    in_amperes = "" if full is None else f" ({found.error * full / FULL:.3g} A)"
    yield (
        f"ANGC and OFST step by up to {found.jump} counts from one segment to the next, and are "
        f"off by {found.error:.0f} counts{in_amperes} from the currents of least loss of any "
        "machine of constant inductances: write the table anew from the machine"
    )


def own_counts(own: Mapping[str, OwnValue], full: float | None) -> int | None:
    """Counts of the largest q current, None where it is not known."""
    amperes, counts = number(own, "IQMAX_A"), number(own, "IQMAX")
    if amperes is not None and full is not None:
        return min(LARGEST, round(amperes * FULL / full))
    return None if counts is None else min(LARGEST, int(counts))


def _observer(own: Mapping[str, OwnValue]) -> Iterator[str]:
    f1 = number(own, "F1")
    machine = observed_machine(own) or observed_machine(own, 1.0)
    if not f1 or machine is None:
        return
    measured = number(own, "VBUS_PARTITIONING_FACTOR") is not None
    whole = constants(machine, int(f1))
    for name, value in whole.items():
        if (measured or name != "C5") and abs(value) > LARGEST:
            yield (
                f"{name} of the observer is {value:d} with F1 {f1:g}, beyond the 16 bits that hold "
                f"it: it wraps to {(value + 32768) % 65536 - 32768:d}"
            )
    wanted = observer_integers(machine)
    if not wanted["F1"]:
        yield "no F1 of the observer makes its constants fit 16 bits: L f is too small"
        return
    former = observer_integers(replace(machine, room=1.0))
    for name, scale in (("GAIN1", "F1"), ("GAIN2", "F2")):
        given, factor = number(own, name), number(own, scale)
        if given is None or not factor:
            continue
        expected = [found[name] * factor / max(found[scale], 1) for found in (wanted, former)]
        room = 1.0 + factor / max(wanted[scale], 1)
        if all(abs(given - one) > room + _ROUNDED * abs(one) for one in expected):
            slow = max(abs(pole) for pole in placed_poles(own, machine))
            yield (
                f"{name} {given:g} is not Workbench's {expected[0]:.0f} for these R, L and rates: "
                f"the slower pole of the observer is {slow:.3g} per period"
                + (", unstable" if slow >= 1.0 else "")
            )
