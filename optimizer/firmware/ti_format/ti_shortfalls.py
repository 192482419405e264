"""What a motor block of TI's lab cannot hold of a design, and what that costs."""

from __future__ import annotations

import math
from collections.abc import Iterator

from dqforge.optimizer.firmware.common_shortfalls import closed_form_currents, other_periods
from dqforge.optimizer.firmware.configuration import Configuration, PiGains
from dqforge.optimizer.firmware.firmware_method import Asked, Price, Shortfall
from dqforge.optimizer.firmware.ti_format.ti_configuration import (
    BANDWIDTHS,
    current_rule,
    speed_rule,
)
from dqforge.optimizer.firmware.ti_format.ti_contradictions import TRIP_SHARE
from dqforge.optimizer.firmware.ti_format.ti_keys import FIRMWARE, number

# Factors that TI's comments give; of the proportional gain of the speed up to 100.
_ADVISED = (0.1, 10.0)
_MOST_OF_SPEED = 100.0


def shortfalls(asked: Asked, held: Configuration) -> tuple[Shortfall, ...]:
    """What the block does not hold of what was asked, each with its price.

    Args:
        asked: What was asked.
        held: What was made of it.
    """
    return (
        *_fixed_bandwidth(asked, held),
        *_factors(held),
        *_currents(asked, held),
        *other_periods(asked, held, FIRMWARE),
        *_range(held),
        *_field_weakening(held),
    )


def _fixed_bandwidth(asked: Asked, held: Configuration) -> Iterator[Shortfall]:
    """What runs where the factors are not compiled in: the firmware's own rule."""
    drive, own = held.drive, BANDWIDTHS.get(held.version)
    gains = held.current_q
    if own is None or gains is None or drive.r_s is None or drive.l_q is None:
        return
    rule = current_rule(drive.r_s, drive.l_q, own.current)
    if _alike(gains, rule):
        return
    prices = [
        Price(f"{of} of the firmware's own rule", its / ours - 1.0, "")
        for of, its, ours in (
            ("q gain", rule.kp, gains.kp),
            ("q integral gain", rule.ki, gains.ki),
        )
        if ours
    ]
    words = (
        f"TI's lab fixes its bandwidth at {own.current / (2.0 * math.pi):.4g} Hz and its integral "
        f"gain at R/(4 L) in code; the factors KP_..._SF and KI_..._SF make {gains.kp:.4g} V/A and "
        f"{gains.ki:.4g} V/(A s) of it only where the project defines MOTOR1_PI_TUNE and sets "
        f"flagEnableTuneController; without them the q axis runs {rule.kp:.4g} V/A and "
        f"{rule.ki:.4g} V/(A s)"
    )
    if asked.speed is not None and drive.pole_pairs and drive.psi_pm and drive.inertia:
        speed = speed_rule(drive.pole_pairs, drive.psi_pm, drive.inertia, own)
        prices.append(Price("speed gain of the firmware's own rule", _off(speed, asked.speed), ""))
        words += (
            f", the speed controller {speed.kp:.4g} A s/rad instead of {asked.speed.kp:.4g} A s/rad"
        )
    yield Shortfall(words, tuple(prices))


def _off(rule: PiGains, wished: PiGains) -> float:
    return rule.kp / wished.kp - 1.0


def _factors(held: Configuration) -> Iterator[Shortfall]:
    least, most = _ADVISED
    for name, value in held.own.items():
        if not name.endswith("_SF") or "_LOW_" in name or "_START_" in name:
            continue
        largest = _MOST_OF_SPEED if "KP_SPD" in name else most
        if isinstance(value, float) and not least <= value <= largest:
            yield Shortfall(
                f"{name} {value:.4g} is outside the {least:g} to {largest:g} that TI's file advises"
            )


def _currents(asked: Asked, held: Configuration) -> Iterator[Shortfall]:
    drive = held.drive
    saliency = (drive.l_q or 0.0) - (drive.l_d or 0.0)
    lead = "TI's currents of most torque per ampere (MOTOR1_MTPA)"
    return closed_form_currents(asked, held, saliency, lead)


def _range(held: Configuration) -> Iterator[Shortfall]:
    """Where nothing is known of how currents are measured."""
    i_max = held.drive.i_max
    if i_max is None or number(held.own, "M1_ADC_FULL_SCALE_CURRENT_A") is not None:
        return
    yield Shortfall(
        f"the range of the measured currents is that of the board's block: for {i_max:.4g} A "
        f"USER_M1_ADC_FULL_SCALE_CURRENT_A must be at least {i_max / TRIP_SHARE:.4g} A; "
        f"inverter.current_sensing in the design writes it"
    )


def _field_weakening(held: Configuration) -> Iterator[Shortfall]:
    """Its field weakening turns the current by at most 15 deg as delivered."""
    flux, most = number(held.own, "RATED_FLUX_VpHz"), number(held.own, "FREQ_MAX_Hz")
    v_dc = held.drive.v_dc
    if not flux or not most or not v_dc:
        return
    reached = v_dc / math.sqrt(3.0) / flux
    if reached < most:
        yield Shortfall(
            f"the back-EMF at FREQ_MAX_Hz {most:.4g} Hz is above the voltage: without MOTOR1_FWC "
            f"the speed ends at {reached:.4g} Hz, with it the current turns by at most 15 deg "
            f"(USER_M1_FWC_MAX_ANGLE), which the block does not hold",
            (Price("speed", 1.0 - reached / most, ""),),
        )


def _alike(one: PiGains, other: PiGains) -> bool:
    kp, ki = (one.kp, other.kp), (one.ki, other.ki)
    return all(math.isclose(*pair, rel_tol=1e-4) for pair in (kp, ki))
