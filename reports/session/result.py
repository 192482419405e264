"""What results of a Python session have in common: plain data, a table in a notebook,
labelled arrays.
"""

from __future__ import annotations

import math
import re
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.numerical import require_design
from dqforge.machines.errors import InputError
from dqforge.machines.records import dataclass
from dqforge.optimizer.control_design.gain_set import GainSet, solve_gains
from dqforge.optimizer.control_design.observed_remedies import require_observed
from dqforge.reports.loops.proven_text import plain_gains
from dqforge.reports.plain_data import PlainData

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from dqforge.machines.design.design import Design
    from dqforge.optimizer.estimator_comparison.candidate import ObserverEvidence
    from dqforge.optimizer.fixed_phase_control.solve import IntegerFit
    from dqforge.optimizer.observers.tuning import ObserverProof
    from dqforge.reports.simulation.design_run import DriveSimulation, StepFigures


_MOST_ROWS = 40
_MOST_LINES, _WIDEST = 9, 100

# Cells of columns that are set to the right.
_NUMERIC = re.compile(r"-|-?[\d.]+(e[-+]?\d+)?")

# Units by the end of a key, the longer ends first; docs/reference/json.md says how keys are named.
_UNITS = {
    "_rad_per_s": "rad/s",
    "_Nms_per_rad": "N m s/rad",
    "_kg_m2": "kg m²",
    "_A_per_s": "A/s",
    "_per_s": "1/s",
    "_degC": "°C",
    "_Ohm": "Ω",
    "_rad": "rad",
    "_percent": "%",
    "_Nm": "N m",
    "_Wb": "Wb",
    "_Hz": "Hz",
    "_A": "A",
    "_B": "bytes",
    "_H": "H",
    "_J": "J",
    "_K": "K",
    "_V": "V",
    "_W": "W",
    "_s": "s",
}


class Result(ABC):
    """A result that can be taken along as plain data and that a notebook shows as a table."""

    __slots__ = ()

    @abstractmethod
    def plain(self) -> PlainData:
        """Everything that was found, arrays as arrays, by the keys of ``--json`` and
        ``result.json``.
        """

    def to_dict(self) -> dict[str, Any]:
        """Plain data: numbers, texts, lists and dicts only; what is infinite or undefined is
        None.
        """
        found = as_lists(self.plain())
        assert isinstance(found, dict)
        return found

    def shown(self) -> tuple[tuple[str, ...], list[tuple[str, ...]]] | None:
        """Headings and rows of the table that is printed; None for names and values."""
        return None

    def __repr__(self) -> str:
        """At most ten lines; `to_dict` has everything."""
        table = self.shown()
        if table is not None:
            return "\n  ".join([type(self).__name__, *_aligned(*table)])
        rows = _rows(self.plain(), "")
        lines = [" ".join(f"  {name}: {text} {unit}".split()) for name, text, unit in rows]
        if len(lines) > _MOST_LINES:
            lines[_MOST_LINES - 1 :] = [f"{len(rows) - _MOST_LINES + 1} more: to_dict() has them"]
        return "\n  ".join([type(self).__name__, *(line[:_WIDEST] for line in lines)])

    def _repr_html_(self) -> str:
        return html_table(type(self).__name__, self.plain())


def _aligned(headings: tuple[str, ...], rows: list[tuple[str, ...]]) -> list[str]:
    """A table in columns, in at most as many lines as a result has."""
    most = _MOST_LINES - 1
    left = rows[: most if len(rows) <= most else most - 1]
    cells = [headings, *left]
    widths = [max(len(row[k]) for row in cells) for k in range(len(headings))]
    lines = [
        "  ".join(
            text.rjust(width)
            if _NUMERIC.fullmatch(left[0][k] if left else "")
            else text.ljust(width)
            for k, (text, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in cells
    ]
    return lines + [f"{len(rows) - len(left)} more: to_dict() has them"] * (len(left) < len(rows))


class DrawnResult(Result):
    """A result that has a figure."""

    __slots__ = ()

    @abstractmethod
    def figure(self) -> Figure:
        """Draw it; a notebook shows what this gives."""

    def plot(self, file: str | Path) -> None:
        """Draw it into a file that ends in .svg, .png or .pdf, or write its data into one that
        ends in .csv.

        The same result gives the same bytes.

        Raises:
            InputError: The file has another ending, or cannot be written.
        """
        from dqforge.reports.pages.answer import check_figure_path
        from dqforge.reports.pages.figures_style import save

        check_figure_path(Path(file))
        save(self.figure(), Path(file))


def as_lists(value: Any) -> Any:
    """Plain data with lists in place of arrays and tuples, and None in place of
    numbers that JSON cannot hold.
    """
    if isinstance(value, Mapping):
        return {str(key): as_lists(entry) for key, entry in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return as_lists(value.tolist())
    if isinstance(value, list | tuple):
        return [as_lists(entry) for entry in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value


def html_table(title: str, plain: PlainData) -> str:
    """A table of names, values and units for a notebook; arrays by their shape and range."""
    rows = list(_rows(plain, ""))
    shown = [
        f"<tr><td>{escape(name)}</td><td>{escape(text)}</td><td>{escape(unit)}</td></tr>"
        for name, text, unit in rows[:_MOST_ROWS]
    ]
    if len(rows) > _MOST_ROWS:
        shown.append(
            f'<tr><td colspan="3">{len(rows) - _MOST_ROWS} more: to_dict() has them all</td></tr>'
        )
    return f"<table><caption>{escape(title)}</caption>{''.join(shown)}</table>"


def _rows(plain: Mapping[str, Any], before: str) -> list[tuple[str, str, str]]:
    """Name, value and unit of all entries, those of nested data with the names above them."""
    found = []
    for key, value in plain.items():
        name = f"{before}{key}"
        if isinstance(value, Mapping):
            found += _rows(value, f"{name}.")
            continue
        end = next((end for end in _UNITS if key.endswith(end)), "")
        found.append((name.removesuffix(end), _text(value), _UNITS.get(end, "")))
    return found


def _text(value: Any) -> str:
    """One value in a few characters."""
    if value is None:
        return "none"
    if isinstance(value, bool | str):
        return str(value)
    if isinstance(value, int | float | np.number):
        return f"{value:.6g}"
    array = _numbers(value)
    if array is None:
        return f"{len(value)} entries"
    if array.size == 1:
        return f"{float(array.ravel()[0]):.6g}"
    size = " x ".join(map(str, array.shape))
    known = array[np.isfinite(array)]
    return (
        f"{size} values, {known.min():.6g} to {known.max():.6g}" if known.size else f"{size} values"
    )


def _numbers(value: Any) -> FloatArray | None:
    """An array of numbers, None of what holds others."""
    try:
        array = np.asarray(value)
    except ValueError:  # rows of different lengths
        return None
    return array.astype(np.float64) if array.dtype.kind in "iuf" and array.ndim else None


def dataset(
    coordinates: Mapping[str, tuple[NDArray[Any], str]],
    values: Mapping[str, tuple[NDArray[Any], str]],
    attributes: Mapping[str, Any],
) -> Any:
    """An xarray.Dataset over coordinates, by name the array and its unit.

    The values run over all of them.

    Raises:
        InputError: xarray is not installed.
    """
    try:
        import xarray
    except ImportError:
        raise InputError(
            "to_xarray needs xarray, which is not installed; pip install xarray"
        ) from None
    names = tuple(coordinates)
    return xarray.Dataset(
        {name: (names, array, {"units": unit}) for name, (array, unit) in values.items()},
        coords={
            name: (name, array, {"units": unit}) for name, (array, unit) in coordinates.items()
        },
        attrs=dict(attributes),
    )


# Gains of loops and observers with their margins, and the simulated drive that runs on them.


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Tuning(DrawnResult):
    """Gains of a design: ``gains.i_d``, ``gains.i_q``, ``gains.speed`` with kp,
    ki and margins in SI units.

    ``fixed`` are control functions in fixed point, ``proof`` what is proven of a position observer;
    both where the design asks for them. ``evidence`` has its errors on warm machines and the starts
    from which it locks, None without a position observer.
    """

    design: Design
    gains: GainSet
    fixed: tuple[IntegerFit, ...] = ()
    proof: ObserverProof | None = None
    evidence: ObserverEvidence | None = None

    def plain(self) -> PlainData:
        """By the keys of ``dqforge tune --json``."""
        plain: PlainData = {"gains": plain_gains(self.design, self.gains)}
        if self.gains.references is not None:
            from dqforge.reports.dynamic_references import plain_references

            plain["dynamic_references"] = plain_references(self.gains.references)
        if self.gains.measured_speed is not None:
            from dqforge.reports.single_headers.speed_measurement import plain_measured

            plain["speed_measurement"] = plain_measured(self.gains.measured_speed)
        if self.proof is not None:
            from dqforge.reports.observers.position_text import plain_proof

            plain["observer_proof"] = plain_proof(self.proof)
        if self.fixed:
            from dqforge.reports.phase_control.emitted_integers import plain_integer_evidence

            integers = {found.control.format: plain_integer_evidence(found) for found in self.fixed}
            plain["control_fixed"] = integers
        return plain | self._plain_evidence()

    def _plain_evidence(self) -> PlainData:
        if self.evidence is None:
            return {}
        from dqforge.reports.estimator_comparison.observer_errors import plain_capture, plain_warm

        return {
            "observer_warm": plain_warm(self.evidence.warm),
            "observer_capture": plain_capture(self.evidence.capture),
        }

    def figure(self) -> Figure:
        """Step responses and open loops with their margins."""
        from dqforge.reports.loops.figures import plot_gains

        return plot_gains(self.gains)


def tune(design: Design) -> Tuning:
    """Tune the loops and the observer of a design, each checked as it is sampled,
    and over its tolerances.

    Args:
        design: Its section ``control`` names methods, bandwidths in rad/s and tolerances.

    Raises:
        NoSolutionError: A loop is unstable or has less margin than required, nominally or at a
            corner of the tolerances; says where. On a position observer as `require_observed`.
    """
    gains = solve_gains(design)
    require_observed(design, gains)
    from dqforge.optimizer.estimator_comparison.candidate import observer_evidence
    from dqforge.optimizer.fixed_phase_control.solve import solve_integers
    from dqforge.optimizer.observers.tuning import prove

    fixed, proof = solve_integers(design, gains), prove(gains.position)
    return Tuning(design, gains, fixed, proof, observer_evidence(design, gains.position))


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class SimulatedDrive(DrawnResult):
    """A drive in the time domain with the emitted controller in the loop.

    Arrays of shape (N,) at its samples.

    ``found.run`` holds all records: phase quantities, duties, estimates.
    """

    found: DriveSimulation

    @property
    def t(self) -> FloatArray:
        """Time in s."""
        return self.found.run.t

    @property
    def omega_m(self) -> FloatArray:
        """Mechanical speed in rad/s."""
        return self.found.run.omega_m

    @property
    def torque(self) -> FloatArray:
        """Air-gap torque in N m."""
        return self.found.run.torque

    @property
    def i_d(self) -> FloatArray:
        """Current along the magnets in A (peak)."""
        return self.found.run.i_d

    @property
    def i_q(self) -> FloatArray:
        """Current across the magnets in A (peak)."""
        return self.found.run.i_q

    @property
    def reference(self) -> FloatArray:
        """What the drive was to follow: rad/s, N m or A, as ``found.unit`` says."""
        return self.found.run.reference

    @property
    def steps(self) -> tuple[StepFigures, ...]:
        """Rise, overshoot and settling of each step of the reference."""
        return self.found.steps

    def plain(self) -> PlainData:
        """By the keys of ``dqforge simulate --json``."""
        from dqforge.reports.simulation.tables import plain_simulation

        return plain_simulation(self.found)

    def figure(self) -> Figure:
        """Reference, controlled value, currents and duties over time."""
        from dqforge.reports.simulation.tables import plot_simulation

        return plot_simulation(self.found)

    def to_xarray(self) -> Any:
        """An xarray.Dataset over the time t; raises `InputError` where xarray is not installed."""
        units = {
            "omega_m": "rad/s",
            "torque": "N m",
            "i_d": "A",
            "i_q": "A",
            "reference": self.found.unit,
        }
        values = {name: (getattr(self, name), unit) for name, unit in units.items()}
        return dataset({"t": (self.t, "s")}, values, {"design": self.found.design.name})


def simulate(
    design: Design, *, switched: bool = False, progress: Callable[[float], None] | None = None
) -> SimulatedDrive:
    """Emit the controller of a design, compile it with the plant, and run the design's scenario.

    Args:
        design: With a section ``simulation``.
        switched: Whether every switching instant is simulated, whatever the section says.
        progress: Called with the share that is done, 0 to 1.

    Raises:
        InputError: There is no such section, or it does not fit the design.
        VerificationError: There is no C compiler.
    """
    from dqforge.reports.firmware.design_simulation import simulate_with_firmware

    require_design(design)
    return SimulatedDrive(simulate_with_firmware(design, switched=switched, progress=progress))
