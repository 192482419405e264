"""Captures of the back-EMF, and phase currents of machines whose back-EMF is not sinusoidal."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.back_emf.capture import analyse
from dqforge.machines.back_emf.columns import CaptureOptions
from dqforge.machines.back_emf.files import MOST_BYTES, read_captures
from dqforge.machines.back_emf.result import BemfResult
from dqforge.machines.design.design import Design
from dqforge.machines.errors import InputError
from dqforge.machines.files.input_files import read_regular_file
from dqforge.machines.phase_machines.phase_machine import PhaseMachine
from dqforge.machines.records import dataclass
from dqforge.optimizer.waveforms.comparison import (
    RuleCurrents,
    WaveformComparison,
    compare_waveforms,
)
from dqforge.reports.back_emf.capture import CaptureReading, plain_capture
from dqforge.reports.plain_data import PlainData
from dqforge.reports.session.drives import numbers, whole
from dqforge.reports.session.result import DrawnResult
from dqforge.reports.waveforms.tables import plain_waveforms

if TYPE_CHECKING:
    from matplotlib.figure import Figure


_MOST_HARMONICS = 200


_MACHINE_HARMONICS = 13


def _angles(count: int) -> FloatArray:
    """A period of electrical angles in rad, shape (count,)."""
    return np.asarray(2.0 * np.pi * np.arange(count) / count, dtype=np.float64)


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class BackEmf(DrawnResult):
    """What a capture of the back-EMF holds.

    ``result`` has harmonics, uncertainty, symmetry and noise.
    """

    reading: CaptureReading

    @property
    def result(self) -> BemfResult:
        """Everything that was found, with arrays per phase."""
        return self.reading.result

    @property
    def psi_pm(self) -> float:
        """Magnet flux linkage of the fundamental in Wb, peak of phase."""
        return self.reading.result.psi_pm

    @property
    def theta_e(self) -> FloatArray:
        """Electrical angle in rad from phase a to the d axis, shape (360,)."""
        return _angles(self.reading.result.waveform.shape[1])

    @property
    def waveform(self) -> FloatArray:
        """Back-EMF over electrical speed in V s/rad, shape (3, 360), over `theta_e`."""
        return self.reading.result.waveform

    @property
    def findings(self) -> tuple[str, ...]:
        """Sentences on what was found."""
        return self.reading.findings

    def machine(
        self,
        *,
        pole_pairs: int,
        r_s: float,
        l_s: float,
        m_s: float,
        i_max: float,
        harmonics: int = _MACHINE_HARMONICS,
    ) -> PhaseMachine:
        """A machine with this back-EMF, the mean of its phases and half waves.

        Args:
            pole_pairs: Number of pole pairs.
            r_s: Phase resistance in Ohm.
            l_s, m_s: Self inductance of a phase and mutual inductance between two in H (``m_s``
                usually negative).
            i_max: Largest phase current in A, peak.
            harmonics: Highest order that is taken.
        """
        found = self.reading.result
        taken = found.orders <= whole(harmonics, "harmonics", 1, _MOST_HARMONICS)
        return PhaseMachine.from_harmonics(
            found.orders[taken],
            found.amplitudes[:, taken],
            found.phases[:, taken],
            pole_pairs=pole_pairs,
            r_s=r_s,
            l_s=l_s,
            m_s=m_s,
            i_max=i_max,
        ).symmetrised()

    def plain(self) -> PlainData:
        """By the keys of ``dqforge bemf --json``."""
        return plain_capture(self.reading)

    def figure(self) -> Figure:
        """The record, the waveform of a period and its spectrum."""
        from dqforge.reports.back_emf.figures import plot_capture

        return plot_capture(self.reading)


def read_back_emf(
    files: str | Path | Sequence[str | Path],
    *,
    pole_pairs: int | None = None,
    omega_m: float | None = None,
    line_to_line: bool = False,
    columns: Sequence[str | int] | None = None,
    scale: tuple[float, float, float] = (1.0, 1.0, 1.0),
    interval: float | None = None,
    harmonics: int = 25,
) -> BackEmf:
    """Read a capture of the back-EMF of three phases: one file, or one for each channel.

    Args:
        files: Text of any layout, .mat, or one of these with .gz behind it.
        pole_pairs: Needed for constants per mechanical speed, and for mechanical angles.
        omega_m: Mechanical speed in rad/s; needed where the capture is over an angle in V.
        line_to_line: Whether the channels are ab, bc and ca instead of a, b, c.
        columns: Headings or one-based numbers of the time (or angle) and the three voltages, where
            they are unusual.
        scale: Factors of the three channels, for probes.
        interval: Time between two samples in s, for files that do not say it.
        harmonics: Highest order, 1 to 200.

    Raises:
        InputError: A file is not what it claims to be, with the line where that begins, or no
            three-phase back-EMF.
    """
    paths = [Path(files)] if isinstance(files, str | Path) else [Path(name) for name in files]
    if interval is not None and not (np.isfinite(interval) and interval > 0.0):
        raise InputError(f"interval: expected a time above 0 in s, got {interval!r}")
    if len(scale) != len("abc"):
        raise InputError(f"scale: expected three factors such as (1.0, 1.0, 10.0), got {scale!r}")
    pairs = None if pole_pairs is None else whole(pole_pairs, "pole_pairs", 1, 1000)
    speed = None if omega_m is None else float(numbers(omega_m, "omega_m", "rad/s"))
    options = CaptureOptions(
        connection="line-to-line" if line_to_line else "phase",
        columns=None if columns is None else list(columns),
        scale=(float(scale[0]), float(scale[1]), float(scale[2])),
        pole_pairs=pairs,
        interval=interval,
    )
    capture = read_captures(
        [str(path) for path in paths],
        lambda name: read_regular_file(name, MOST_BYTES),
        lambda name: Path(name).is_file(),
        options,
    )
    orders = whole(harmonics, "harmonics", 1, _MOST_HARMONICS)
    result = analyse(capture, pole_pairs=pairs, speed=speed, harmonics=orders)
    return BackEmf(CaptureReading(", ".join(path.name for path in paths), capture, result, pairs))


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Waveforms(DrawnResult):
    """Phase currents of every rule at one operating point: dq, dqx, dqy,
    and the best within all limits.

    ``found`` holds limits, confirmations and the price of smoothness.
    """

    found: WaveformComparison

    @property
    def theta_e(self) -> FloatArray:
        """Electrical angle in rad, shape (N,), over a mechanical turn where pole pairs differ."""
        return self.found.machine.theta

    @property
    def rules(self) -> dict[str, RuleCurrents]:
        """By name the rules that have currents: in A, shape (3, N), with torque in N m, shape (N,),
        and figures.
        """
        return {rule.rule: rule for rule in self.found.rules}

    def plain(self) -> PlainData:
        """By the keys of ``waveforms`` in ``result.json``."""
        return plain_waveforms(self.found)

    def figure(self) -> Figure:
        """Back-EMF, currents, torque and spectra of the rules."""
        from dqforge.reports.waveforms.figures import plot_waveforms

        return plot_waveforms(self.found)


def waveforms(
    design: Design,
    *,
    torque: float | None = None,
    omega_m: float | None = None,
    ripple: float | None = None,
    open_phase: str | None = None,
) -> Waveforms:
    """Shape the phase currents of a machine whose back-EMF is not sinusoidal.

    Args:
        design: With a machine of the model ``waveform``.
        torque, omega_m: Operating point in N m and rad/s (mechanical); None for those of the
            design, else the largest torque of the closed forms and the base speed.
        ripple: Permitted deviation of the torque from its mean, relative, 0 to below 1; None for
            the design's.
        open_phase: A phase without current: ``a``, ``b`` or ``c``; None for the design's.

    Raises:
        InputError: The back-EMF of the machine is sinusoidal, or an argument is none that can be.
        NoSolutionError: No currents keep the limits; says what would have to give.
    """
    changes: dict[str, Any] = {}
    for name, value, unit in (
        ("torque", torque, "N m"),
        ("omega_m", omega_m, "rad/s"),
        ("ripple", ripple, "1"),
    ):
        if value is not None:
            changes[name] = float(numbers(value, name, unit))
    if not 0.0 <= changes.get("ripple", 0.0) < 1.0:
        raise InputError(f"ripple: expected a share from 0 to below 1, got {ripple!r}")
    if open_phase is not None:
        if open_phase not in {"a", "b", "c"}:
            raise InputError(f"open_phase: expected a, b or c, got {open_phase!r}")
        changes["open_phase"] = open_phase
    return Waveforms(compare_waveforms(design, replace(design.waveform, **changes)))
