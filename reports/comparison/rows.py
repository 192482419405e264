"""Quantities of two designs or results side by side: machine, limits, references,
gains and phase currents.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable
from dataclasses import dataclass

from dqforge.machines.errors import InputError
from dqforge.reports.comparison.sources import Side

Value = float | str | None


# Shares below this are rounding, which moves with every input.
_ROUNDING = 1e-14


@dataclass(frozen=True, slots=True)
class Row:
    """One quantity of both sides.

    ``unit`` is that of the text (`format_quantity`); numbers are in SI, angles in rad, shares as
    fractions. A side that lacks the quantity has None.
    """

    section: str
    label: str
    unit: str
    a: Value
    b: Value

    @property
    def differs(self) -> bool:
        """Whether the two sides are not the same."""
        return self.a != self.b

    @property
    def difference(self) -> float | None:
        """B less A; None where they are no numbers."""
        if isinstance(self.a, str) or isinstance(self.b, str) or self.a is None or self.b is None:
            return None
        return self.b - self.a

    @property
    def relative(self) -> float | None:
        """The difference relative to A; None where that is 0 or no number."""
        if self.difference is None or not isinstance(self.a, float | int) or self.a == 0.0:
            return None
        return self.difference / abs(self.a)


_MACHINE: tuple[tuple[str, str, str], ...] = (
    ("pole pairs", "pole_pairs", ""),
    ("phase resistance", "r_s_Ohm", "Ohm"),
    ("inductance d", "l_d_H", "H"),
    ("inductance q", "l_q_H", "H"),
    ("magnet flux linkage", "psi_pm_Wb", "Wb"),
    ("inertia", "inertia_kg_m2", "kg m^2"),
    ("friction", "friction_Nms_per_rad", "N m s/rad"),
)


_LIMITS: tuple[tuple[str, str, str], ...] = (
    ("current limit (peak)", "i_max_A", "A"),
    ("largest speed", "omega_m_max_rad_per_s", "rpm"),
    ("DC link", "v_dc_V", "V"),
    ("switching frequency", "f_sw_Hz", "Hz"),
    ("dead time", "dead_time_s", "s"),
    ("topology", "topology", ""),
    ("sampling period", "t_s_s", "s"),
)


_ERRORS: tuple[tuple[str, str, str], ...] = (
    ("i_d error", "i_d", "A"),
    ("i_q error", "i_q", "A"),
    ("torque error", "torque_relative", "%"),
    ("copper loss penalty", "loss_relative", "%"),
    ("voltage excess", "voltage_excess", "%"),
)


_LOOP: tuple[tuple[str, str, str], ...] = (
    ("phase margin", "phase_margin_rad", "deg"),
    ("gain margin (factor)", "gain_margin", ""),
    ("delay margin", "delay_margin_s", "s"),
    ("M_s", "max_sensitivity", ""),
)


_OBSERVER: tuple[tuple[str, str, str], ...] = (
    ("A", "a", ""),
    ("B_U", "b_u", "rad/(s V)"),
    ("B_I", "b_i", "rad/(s A)"),
    ("C", "c", "rad/(s A)"),
)


def _checked(side: Side, *path: str) -> Value:
    """A number or text of a side."""
    found = side.value(*path)
    if found is None or isinstance(found, str):
        return found
    if isinstance(found, bool) or not isinstance(found, int | float):
        raise InputError(
            f"{'.'.join(path)}: expected a number or a text; run the design again",
            source=side.source,
        )
    return float(found)


def _row(sides: tuple[Side, Side], section: str, label: str, unit: str, *path: str) -> Row:
    return Row(section, label, unit, _checked(sides[0], *path), _checked(sides[1], *path))


def _share_row(sides: tuple[Side, Side], section: str, label: str, unit: str, *path: str) -> Row:
    """As `_row`, less what is only rounding."""
    a, b = (_checked(side, *path) for side in sides)
    if unit == "%":
        a, b = (
            0.0 if isinstance(value, float) and abs(value) < _ROUNDING else value
            for value in (a, b)
        )
    return Row(section, label, unit, a, b)


def _derived(
    sides: tuple[Side, Side], section: str, label: str, unit: str, of: Callable[[Side], Value]
) -> Row:
    return Row(section, label, unit, of(sides[0]), of(sides[1]))


def _checksum(side: Side) -> str:
    text = json.dumps(side.result["header"]["reference"], sort_keys=True)
    return hashlib.sha256(text.encode("ascii")).hexdigest()[:12]


def _hertz(path: tuple[str, ...]) -> Callable[[Side], Value]:
    def frequency(side: Side) -> Value:
        omega = _checked(side, *path)
        return omega / (2.0 * math.pi) if isinstance(omega, float) else None

    return frequency


def _drive_rows(sides: tuple[Side, Side]) -> list[Row]:
    machine = [_row(sides, "machine", label, unit, "drive", key) for label, key, unit in _MACHINE]
    limits = [_row(sides, "limits", label, unit, "drive", key) for label, key, unit in _LIMITS]
    return machine + limits


def _reference_rows(sides: tuple[Side, Side]) -> list[Row]:
    section = "current reference"
    rows = [
        _row(sides, section, "strategy", "", "drive", "strategy"),
        _row(sides, section, "holds at", "rpm", "drive", "reference_omega_m_rad_per_s"),
        _row(sides, section, "form", "", "fit", "form"),
        _row(sides, section, "method", "", "fit", "method"),
        _row(sides, section, "number format", "", "fit", "reference", "format"),
        _row(sides, section, "degree", "", "fit", "degree"),
        _row(sides, section, "segments", "", "fit", "segments"),
        _row(sides, section, "largest torque", "N m", "fit", "torque_max_Nm"),
        *(
            _share_row(sides, section, f"{label}, found", unit, "fit", "errors", key)
            for label, key, unit in _ERRORS
        ),
        *(
            _share_row(sides, section, f"{label}, proven", unit, "fit", "certificate", key)
            for label, key, unit in _ERRORS
        ),
        _derived(sides, section, "bytes of constants", "", lambda side: side.constant_bytes),
        _derived(sides, section, "checksum of constants", "", _checksum),
    ]
    for key, unit, label in (
        ("flash_B", "", "bytes of the surface"),
        ("omega_m_rad_per_s", "rpm", "surface up to"),
    ):
        rows.append(_row(sides, section, label, unit, "weakening", key))
    return rows


def _gain_rows(sides: tuple[Side, Side]) -> list[Row]:
    rows = []
    units = {
        "i_d": ("V/A", "V/(A s)"),
        "i_q": ("V/A", "V/(A s)"),
        "speed": ("N m s/rad", "N m/rad"),
    }
    for loop, (kp, ki) in units.items():
        section, path = f"{loop} loop", ("gains", loop)
        rows += [
            _row(sides, section, "method", "", *path, "method"),
            _row(sides, section, "kp", kp, *path, "kp"),
            _row(sides, section, "ki", ki, *path, "ki"),
            _row(sides, section, "sampled every", "s", *path, "t_s"),
            _derived(
                sides,
                section,
                "bandwidth (crossover)",
                "Hz",
                _hertz((*path, "crossover_rad_per_s")),
            ),
            *(_row(sides, section, label, unit, *path, key) for label, key, unit in _LOOP),
        ]
    rows += [
        _row(sides, "observer", label, unit, "gains", "observer", key)
        for label, key, unit in _OBSERVER
    ]
    return rows


def _waveform_rows(sides: tuple[Side, Side]) -> list[Row]:
    rows = [
        _row(sides, "phase currents", "torque", "N m", "waveforms", "torque_Nm"),
        _row(sides, "phase currents", "speed", "rpm", "waveforms", "omega_m_rad_per_s"),
    ]
    for rule in ("dq", "dqx", "dqy", "limited"):
        path = ("waveforms", "rules", rule)
        rows.append(_row(sides, "phase currents", f"copper loss, {rule}", "W", *path, "copper_W"))
    return rows


def quantity_rows(sides: tuple[Side, Side]) -> tuple[Row, ...]:
    """Rows of every quantity that at least one of two results has, whether it differs or not.

    Raises
    ------
    InputError
        A result holds something else than dqforge writes.
    """
    rows = [
        *_drive_rows(sides),
        *_reference_rows(sides),
        *_gain_rows(sides),
        *_waveform_rows(sides),
    ]
    return tuple(row for row in rows if row.a is not None or row.b is not None)


def code_row(sides: tuple[Side, Side]) -> Row:
    """Checksums of what the headers compile to, without comments and prefixes."""
    a, b = (
        None if side.code is None else hashlib.sha256(side.code.encode()).hexdigest()[:12]
        for side in sides
    )
    return Row("header", "checksum of the code", "", a, b)
