"""Configurations and judged loops of firmware as tables, in engineering units."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING

from dqforge.machines.units.quantities import format_quantity
from dqforge.reports.loops.firmware_text import pole_text
from dqforge.reports.pages.table import Table

if TYPE_CHECKING:
    from dqforge.optimizer.firmware.configuration import (
        Configuration,
        DriveValues,
        Origin,
        PiGains,
    )
    from dqforge.optimizer.firmware.explained import Explained, OwnGains
    from dqforge.optimizer.firmware.firmware_method import Shortfall
    from dqforge.optimizer.firmware.judge import JudgedFirmware, JudgedLoop
    from dqforge.optimizer.firmware.profile import LoopProfile
    from dqforge.optimizer.firmware.solve import FirmwareFit

# Fields of `DriveValues` with their names and units.
FIELDS = (
    ("pole_pairs", "pole pairs", ""),
    ("r_s", "phase resistance", "Ohm"),
    ("l_d", "inductance d", "H"),
    ("l_q", "inductance q", "H"),
    ("psi_pm", "magnet flux linkage", "Wb"),
    ("inertia", "inertia", "kg m^2"),
    ("viscous", "friction", "N m s/rad"),
    ("i_max", "current limit (peak)", "A"),
    ("omega_m_max", "largest speed", "rpm"),
    ("v_dc", "DC link", "V"),
    ("f_sw", "switching frequency", "Hz"),
    ("dead_time", "dead time", "s"),
    ("t_s", "period of the current control", "s"),
    ("t_speed", "period of the speed control", "s"),
    ("shunt", "shunt of the current measurement", "Ohm"),
    ("sense_gain", "its amplifier", ""),
    ("sense_reference", "reference of the converter", "V"),
)

_GAINS = (
    ("current_d", "d current controller", "V/A", "V/(A s)"),
    ("current_q", "q current controller", "V/A", "V/(A s)"),
    ("speed", "speed controller (q current)", "A s/rad", "A/rad"),
)

_LOOPS = (("current_d", "i_d"), ("current_q", "i_q"), ("speed", "speed"))

_COLUMNS = (
    "",
    "crossover Hz",
    "bandwidth Hz",
    "phase margin deg",
    "gain margin dB",
    "delay margin us",
    "M_s",
    "damping",
    "",
)

_SHOWN = {"rad": "deg"}


def value_rows(drive: DriveValues) -> list[tuple[str, str, str]]:
    """Field, name and text of every value that is known."""
    found = []
    for name, label, unit in FIELDS:
        value = getattr(drive, name)
        if value is not None:
            found.append((name, label, format_quantity(float(value), unit) if unit else f"{value}"))
    return found


def _gain_rows(found: Configuration) -> Iterator[tuple[str, str, str]]:
    for name, label, unit_p, unit_i in _GAINS:
        gains: PiGains | None = getattr(found, name)
        if gains is not None:
            yield f"{name}.kp", f"{label}, kp", format_quantity(gains.kp, unit_p)
            yield f"{name}.ki", f"{label}, ki", format_quantity(gains.ki, unit_i)


def configuration_table(found: Configuration, title: str) -> Table:
    """Every value: in SI, as it is written in the file and where, and how it was converted."""
    rows: list[tuple[str, ...]] = []
    shown: set[str] = set()
    for name, label, text in (*value_rows(found.drive), *_gain_rows(found)):
        origin = found.origins.get(name)
        shown.add("" if origin is None else origin.key)
        rows.append((label, text, *_placed(origin)))
    for key, value in found.own.items():
        origin = found.origins.get(key)
        if key in shown or (origin is not None and origin.key in shown):
            continue
        text = f"{value:.9g}" if isinstance(value, float) else str(value)
        rows.append((key, "", *((text, "", "") if origin is None else _placed(origin))))
    columns = ("", "value", "in the file", "line", "conversion")
    notes = (
        *(f"convention: {sentence}" for sentence in found.conventions),
        *(f"contradiction: {sentence}" for sentence in found.contradictions),
    )
    return Table(title, columns, tuple(rows), notes)


def _placed(origin: Origin | None) -> tuple[str, str, str]:
    """What stands in the file, its line, and how it was converted."""
    if origin is None:
        return "", "", ""
    line = "" if origin.line is None else str(origin.line)
    return f"{origin.key} {origin.text}".strip(), line, origin.conversion


def loops_table(found: JudgedFirmware, title: str, profile: LoopProfile | None = None) -> Table:
    """Margins of each loop, with the poles of what observes speed and angle."""
    rows = tuple(
        _loop_cells(label, loop)
        for name, label in _LOOPS
        if (loop := getattr(found, name)) is not None
    )
    return Table(
        title, _COLUMNS if rows else (), rows, (*_observed(found, profile), *found.remarks)
    )


def _loop_cells(label: str, loop: JudgedLoop) -> tuple[str, ...]:
    return (
        label,
        _number(loop.crossover / (2.0 * math.pi)),
        _number(loop.bandwidth / (2.0 * math.pi)),
        _number(math.degrees(loop.phase_margin)),
        _number(20.0 * math.log10(loop.gain_margin)),
        _number(1e6 * loop.delay_margin),
        _number(loop.max_sensitivity),
        _number(loop.damping),
        "stable" if loop.stable else "UNSTABLE",
    )


def _number(value: float) -> str:
    if not math.isfinite(value):
        return "-"
    text = f"{value:.4g}"
    return f"{value:.0f}" if "e+" in text and abs(value) < 1e7 else text


def _observed(found: JudgedFirmware, profile: LoopProfile | None) -> Iterator[str]:
    if found.pll_poles is not None:
        poles = " and ".join(pole_text(pole) for pole in found.pll_poles)
        yield f"phase-locked loop of the speed: poles at {poles} rad/s"
    observer = None if profile is None else profile.observer
    if observer is not None:
        rate = "" if observer.rate is None else f", errors decay with {observer.rate:.4g} rad/s"
        yield f"position observer: {observer.name}{rate}"
        yield from observer.warnings


def shortfall_table(found: tuple[Shortfall, ...]) -> list[Table]:
    """What the format cannot hold; no table where it holds everything."""
    if not found:
        return []
    rows = tuple((shortfall.words, price_text(shortfall)) for shortfall in found)
    return [Table("what the format cannot hold", ("what is lost", "price"), rows)]


def price_text(shortfall: Shortfall) -> str:
    """What a shortfall costs, in numbers; "" where there are none."""
    texts = []
    for price in shortfall.prices:
        if price.unit:
            unit = _SHOWN.get(price.unit, price.unit)
            texts.append(f"{price.of} {format_quantity(price.value, unit)}")
        else:
            texts.append(f"{price.of} {100.0 * price.value:.3g} %")
    return ", ".join(texts)


def explained_tables(found: Explained, source: str, title: str) -> list[Table]:
    """A file of a firmware, and its loops."""
    runs = f"loops as {found.configuration.firmware} runs them"
    return [
        configuration_table(found.configuration, f"{source}: {title}"),
        loops_table(found.judged, runs, found.profile),
    ]


def own_tables(found: OwnGains, judged: JudgedFirmware, source: str) -> list[Table]:
    """Gains that dqforge wrote, on a machine, and their loops."""
    rows = [(label, text) for _, label, text in value_rows(found.drive)]
    units = (("V/A", "V/(A s)"), ("V/A", "V/(A s)"), ("N m s/rad", "N m/rad"))
    for (name, label), (unit_p, unit_i) in zip(_LOOPS, units, strict=True):
        gains: PiGains | None = getattr(found, name)
        if gains is not None:
            rows.append((f"{label} kp", format_quantity(gains.kp, unit_p)))
            rows.append((f"{label} ki", format_quantity(gains.ki, unit_i)))
    return [
        Table(f"{source}: gains of dqforge", ("", "value"), tuple(rows)),
        loops_table(judged, "loops as the emitted control runs them"),
    ]


def fit_tables(found: FirmwareFit, read: Configuration, title: str) -> list[Table]:
    """What was written for a firmware (as its file reads back), its loops, and what is lost."""
    return [
        configuration_table(read, title),
        loops_table(found.judged, f"loops as {found.name} runs them", found.profile),
        *shortfall_table(found.shortfalls),
    ]
