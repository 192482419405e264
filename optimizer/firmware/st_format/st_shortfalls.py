"""What the MCSDK cannot hold of a design, with what it costs."""

from __future__ import annotations

import math
from collections.abc import Iterator

from dqforge.optimizer.firmware.configuration import Configuration, PiGains
from dqforge.optimizer.firmware.firmware_method import Asked, Price, Shortfall
from dqforge.optimizer.firmware.own_values import number
from dqforge.optimizer.firmware.st_format.st_observer import tracking_integers
from dqforge.optimizer.firmware.st_format.st_scales import (
    SPEED_UNIT,
    control_rate,
    current_scale,
    integers,
)
from dqforge.optimizer.firmware.st_format.st_table import table_price

_SEEN = 1e-3  # Relative change of a gain from which on its rounding is told.
_BUILTIN = 0.02  # Relative difference of the inductances from which on two are missed.


def shortfalls(asked: Asked, found: Configuration) -> tuple[Shortfall, ...]:
    """Of a configuration that `configure` has made of what was asked."""
    return (
        *_inductances(asked),
        *_table(asked, found),
        *_rounding(asked, found),
        *_speed(asked, found),
        *_tracking(found),
    )


def _inductances(asked: Asked) -> Iterator[Shortfall]:
    l_d, l_q = asked.drive.l_d, asked.drive.l_q
    if l_d is None or not l_q or abs(l_d / l_q - 1.0) < _BUILTIN:
        return
    yield Shortfall(
        f"the headers hold one inductance, LS = L_q = {l_q:.4g} H: the observer takes it for both "
        f"axes, L_d = {l_d:.4g} H stands in the motor file alone; both current controllers have "
        "gains of their own",
        (Price("inductance of the observer", l_q / l_d - 1.0, ""),),
    )


def _table(asked: Asked, found: Configuration) -> Iterator[Shortfall]:
    full, width = current_scale(found.own), number(found.own, "SEGDIV")
    slopes, offsets = integers(found.own.get("ANGC")), integers(found.own.get("OFST"))
    if full is None or not width or slopes is None or offsets is None:
        return
    price = table_price(asked, full, int(width), slopes, offsets)
    yield Shortfall(
        f"d current by eight segments of integers: off by at most {price.error:.1f} counts "
        f"({price.error_current:.3f} A) from the currents of least loss, the least that the format "
        f"permits; {100.0 * price.loss:.2g} % more copper loss at most",
        (
            Price("d current", price.error_current, "A"),
            Price("copper loss", price.loss, ""),
            Price("torque", price.torque, ""),
        ),
    )


def _rounding(asked: Asked, found: Configuration) -> Iterator[Shortfall]:
    pairs: list[tuple[str, PiGains | None, PiGains | None]] = [
        ("d current", asked.current_d, found.current_d),
        ("q current", asked.current_q, found.current_q),
        ("speed", asked.speed, found.speed),
    ]
    for name, wanted, made in pairs:
        if wanted is None or made is None:
            continue
        for gain, one, other in (("kp", wanted.kp, made.kp), ("ki", wanted.ki, made.ki)):
            off = 0.0 if one == 0.0 else other / one - 1.0
            if abs(off) > _SEEN:
                yield Shortfall(
                    f"{gain} of the {name} loop is {other:.4g} instead of {one:.4g}, rounded to "
                    "integers",
                    (Price(f"{gain} of the {name} loop", off, ""),),
                )


def _speed(asked: Asked, found: Configuration) -> Iterator[Shortfall]:
    if found.speed is None:
        return
    unit = SPEED_UNIT * 30.0 / math.pi
    yield Shortfall(
        f"the speed is controlled in steps of 0.1 Hz, {unit:g} rpm",
        (Price("speed", SPEED_UNIT, "rad/s"),),
    )
    wanted, made = asked.drive.t_speed, found.drive.t_speed
    if wanted is not None and made is not None and abs(made / wanted - 1.0) > _SEEN:
        yield Shortfall(
            f"the speed controller runs at {1.0 / made:g} Hz, a part of its timer of 2000 Hz, "
            f"instead of {1.0 / wanted:.5g} Hz",
            (Price("period of the speed controller", made - wanted, "s"),),
        )


def _tracking(found: Configuration) -> Iterator[Shortfall]:
    """A phase-locked loop that is faster than Workbench's, for the speed loop's sake."""
    own = found.own
    gain, top, rate = (
        number(own, "PLL_KP_GAIN"),
        number(own, "MAX_APPLICATION_SPEED_RPM"),
        control_rate(own),
    )
    pairs = number(own, "POLE_PAIR_NUM")
    if gain is None or top is None or rate is None or pairs is None:
        return
    usual = tracking_integers(int(pairs), top, rate)["PLL_KP_GAIN"]
    if usual and gain > 1.01 * usual:
        yield Shortfall(
            f"the speed loop needs PLL_KP_GAIN {gain:g} where Workbench has {usual}: the speed is "
            f"{gain / usual:.2g} times as noisy",
            (Price("noise of the speed", gain / usual - 1.0, ""),),
        )
