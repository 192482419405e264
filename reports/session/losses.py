"""Losses of strategies, modulators and switching frequencies, at points and over maps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.machines.back_emf.capture import analyse
from dqforge.machines.back_emf.columns import MOST_BYTES, BemfResult, CaptureOptions, read_captures
from dqforge.machines.design.design import Design
from dqforge.machines.design.numerical import on_design, require_design
from dqforge.machines.design.settings import AnyStrategy, LoadPoint, LossSettings, LossStrategy
from dqforge.machines.errors import InputError, VerificationError
from dqforge.machines.files.input_files import read_regular_file
from dqforge.machines.files.scratch import scratch_folder
from dqforge.machines.modulation.registry import MODULATORS
from dqforge.machines.names import ModulationName
from dqforge.machines.phase_machines.phase_machine import PhaseMachine
from dqforge.machines.records import dataclass
from dqforge.machines.topologies import TOPOLOGIES
from dqforge.optimizer import solution as solved
from dqforge.optimizer.losses.drive_comparison import Alternatives
from dqforge.optimizer.losses.loss_map import LossMap as FoundMap
from dqforge.optimizer.losses.loss_map import budget_options, solve_map
from dqforge.optimizer.losses.phase_comparison import CENTRED, LossComparison, compare_points
from dqforge.optimizer.waveforms.comparison import (
    RuleCurrents,
    WaveformComparison,
    compare_waveforms,
)
from dqforge.reports.back_emf import CaptureReading, plain_capture
from dqforge.reports.losses.map_tables import loss_lines, map_lines, plain_losses, plain_map
from dqforge.reports.output.folder import RUN, write_output
from dqforge.reports.output.recomputation import (
    Recomputation,
    first_difference,
    read_listed,
    recompute,
)
from dqforge.reports.plain_data import PlainData
from dqforge.reports.run import export_design, plain_solution, verify_folder
from dqforge.reports.run_folder import INPUT_DESIGN
from dqforge.reports.session.drives import asked_of, numbers, share_kept, single, together, whole
from dqforge.reports.session.result import DrawnResult, Result, Tuning, dataset
from dqforge.reports.verification.host import Verification
from dqforge.reports.waveforms.tables import plain_waveforms

if TYPE_CHECKING:
    from matplotlib.figure import Figure


_DEFAULT_STRATEGIES: tuple[LossStrategy, ...] = ("mtpa",)


_DEFAULT_MODULATIONS: tuple[ModulationName, ...] = ("spwm", "svpwm", "dpwm1", "ddt-gdpwm")


_MOST_CELLS = 2000


_MOST_BUDGETS = 4_000_000


_SLOWEST, _FASTEST = 1.0, 1e7


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Losses(DrawnResult):
    """Losses of S strategies with M modulators at P points.

    ``found.budget`` holds every kind of loss in W and the temperatures in degC, arrays of shape (S,
    M, P).
    """

    design: Design
    found: LossComparison

    @property
    def strategies(self) -> tuple[AnyStrategy, ...]:
        """Labels of the first axis."""
        return self.found.strategies

    @property
    def modulations(self) -> tuple[ModulationName, ...]:
        """Labels of the second axis."""
        return self.found.modulations

    @property
    def points(self) -> tuple[LoadPoint, ...]:
        """Labels of the third axis: ``torque`` in N m and ``omega_m`` in rad/s."""
        return self.found.points

    @property
    def total(self) -> FloatArray:
        """Total loss in W over `strategies`, `modulations` and `points`, shape (S, M, P); nan
        where the torque is out of reach.
        """
        return self.found.budget.total

    @property
    def usable(self) -> NDArray[np.bool_]:
        """Where torque and voltage are made and every temperature is permitted, shape (S, M, P)."""
        return self.found.usable

    @property
    def best(self) -> tuple[tuple[AnyStrategy, ModulationName] | None, ...]:
        """Who loses least at each point, None where none is usable, and where ``found.compared`` is
        false: without a device in the inverter modulators are not compared.
        """
        return self.found.best_labels

    def shown(self) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
        """Total loss and junction of every alternative at every point."""
        return loss_lines(self.found)

    def plain(self) -> PlainData:
        """By the keys of ``losses`` in ``result.json``."""
        found = plain_losses(self.found)
        return {} if found is None else found

    def figure(self) -> Figure:
        """Bars of each kind of loss."""
        from dqforge.reports.losses.map_figures import plot_losses

        return plot_losses(self.design, self.found)


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class LossMap(DrawnResult):
    """Losses of alternatives over N torques in N m and M mechanical speeds in rad/s.

    ``found.comparison`` holds the budgets; flat indices of alternatives are those of `label`.
    """

    found: FoundMap

    @property
    def torque(self) -> FloatArray:
        """In N m, shape (N,)."""
        return self.found.torque

    @property
    def omega_m(self) -> FloatArray:
        """In rad/s, shape (M,)."""
        return self.found.omega_m

    @property
    def labels(self) -> tuple[tuple[AnyStrategy, ModulationName, float], ...]:
        """Strategy, modulator and switching frequency in Hz of each of the A alternatives."""
        alternatives = self.found.comparison.alternatives
        return tuple(alternatives.label(k) for k in range(int(np.prod(alternatives.shape))))

    @property
    def total(self) -> FloatArray:
        """Total loss in W, shape (A, N, M); nan where the alternative cannot be used."""
        comparison = self.found.comparison
        usable = np.where(comparison.usable, comparison.budget.total, np.nan)
        return usable.reshape(-1, self.torque.size, self.omega_m.size)

    @property
    def best(self) -> NDArray[np.intp]:
        """Index of the alternative that loses least, shape (N, M); -1 where none can be used, and
        without a device in the inverter where modulators or frequencies would be compared.
        """
        return self.found.comparison.best.reshape(self.torque.size, self.omega_m.size)

    def shown(self) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
        """Mean loss and share of the map of every alternative."""
        return map_lines(self.found)

    def plain(self) -> PlainData:
        """By the keys of ``dqforge losses --map --json``."""
        return plain_map(self.found)

    def figure(self) -> Figure:
        """Who loses least where, and the mean losses of all."""
        from dqforge.reports.losses.map_figures import plot_loss_map

        return plot_loss_map(self.found)

    def to_xarray(self) -> Any:
        """An xarray.Dataset over alternative, torque and omega_m.

        Raises `InputError` where xarray is not installed.
        """
        names = np.array([f"{s} {m} {f:g} Hz" for s, m, f in self.labels])
        axes = {
            "alternative": (names, "1"),
            "torque": (self.torque, "N m"),
            "omega_m": (self.omega_m, "rad/s"),
        }
        return dataset(axes, {"loss": (self.total, "W")}, {})


def _chosen(
    names: Sequence[str] | None, known: tuple[str, ...], what: str
) -> tuple[str, ...] | None:
    """Names in their usual order, None where none were given."""
    if names is None:
        return None
    wanted = (names,) if isinstance(names, str) else tuple(names)
    for name in wanted:
        if name not in known:
            raise InputError(f"{what}: expected some of {', '.join(known)}, got {name!r}")
    if not wanted:
        raise InputError(f"{what}: name at least one, such as {known[0]!r}")
    return tuple(name for name in known if name in wanted)


def _strategies(
    names: Sequence[str] | None, default: tuple[LossStrategy, ...]
) -> tuple[LossStrategy, ...]:
    known: tuple[LossStrategy, ...] = get_args(LossStrategy)
    wanted = _chosen(names, known, "strategies")
    return default if wanted is None else tuple(name for name in known if name in wanted)


def _modulations(
    names: Sequence[str] | None, default: tuple[ModulationName, ...]
) -> tuple[ModulationName, ...]:
    known: tuple[ModulationName, ...] = tuple(MODULATORS)
    wanted = _chosen(names, known, "modulations")
    return default if wanted is None else tuple(name for name in known if name in wanted)


def _frequencies(design: Design, f_sw: ArrayLike | None) -> tuple[float, ...]:
    """Switching frequencies in Hz, that of the design where none are given."""
    if f_sw is None:
        return (design.inverter.f_sw,)
    found = tuple(np.atleast_1d(numbers(f_sw, "f_sw", "Hz")).ravel().tolist())
    if (
        not found
        or any(not _SLOWEST <= f <= _FASTEST for f in found)
        or len(set(found)) != len(found)
    ):
        raise InputError(
            f"f_sw: expected each frequency once, {_SLOWEST:g} Hz to {_FASTEST:g} Hz, got "
            f"{list(found)}"
        )
    return found


def _one_frequency(design: Design, f_sw: float | None) -> float:
    """The switching frequency in Hz of a comparison at points."""
    if f_sw is None:
        return design.inverter.f_sw
    instead = "losses compares at one, loss_map at several"
    return _frequencies(design, single(f_sw, "f_sw", "Hz", instead))[0]


def _check_rules(
    design: Design, strategies: Sequence[str] | None, modulations: Sequence[str] | None
) -> None:
    """Refuse alternatives that machines with any back-EMF, or their inverters, do not have."""
    if design.phase_machine is None:
        return
    if strategies is not None and isinstance(design.phase_machine, PhaseMachine):
        raise InputError(
            "strategies: this machine with any back-EMF is compared by the rules dq, dqx, dqy and "
            "limited; omit strategies"
        )
    topology = design.inverter.topology
    if modulations is not None and not TOPOLOGIES[topology].modulated:
        raise InputError(
            f"modulations: the topology {topology} has one modulator, {CENTRED}; omit modulations"
        )


def losses(
    design: Design,
    torque: ArrayLike | None = None,
    omega_m: ArrayLike | None = None,
    *,
    strategies: Sequence[str] | None = None,
    modulations: Sequence[str] | None = None,
    f_sw: float | None = None,
    margin: float | None = None,
) -> Losses:
    """Complete loss budgets of strategies and modulators, at points or at
    those that the design names.

    Args:
        design: With a device in its inverter the bridge counts, too.
        torque, omega_m: Torques in N m and mechanical speeds in rad/s, broadcast together to P
            points; None for those of the section ``losses`` of the design.
        strategies: Some of ``mtpa``, ``id0``, ``least-loss``; None for the design's, else ``mtpa``.
            Machines with any back-EMF are compared by the rules ``dq``, ``dqx``, ``dqy`` and
            ``limited``.
        modulations: Modulators by name; None for the design's, else spwm, svpwm, dpwm1 and
            ddt-gdpwm.
        f_sw: One switching frequency in Hz, `loss_map` takes several; None for the design's.
        margin: Share of the voltage that is kept for control; None for the design's.

    Raises:
        InputError: A name is unknown, a number is not finite, several frequencies are given, or the
            design names no points and none are given.
    """
    require_design(design)
    _check_rules(design, strategies, modulations)
    settings = design.losses
    if (torque is None) != (omega_m is None):
        raise InputError(
            "losses: give torque and omega_m together, or neither for the points of the design"
        )
    if torque is None or omega_m is None:
        if settings is None or not settings.points:
            raise InputError(
                "losses: the design names no points; give torque in N m and omega_m in rad/s"
            )
        points = settings.points
    else:
        wanted, speed = numbers(torque, "torque", "N m"), numbers(omega_m, "omega_m", "rad/s")
        shape = together({"torque": wanted, "omega_m": speed})
        pairs = zip(
            *(np.broadcast_to(part, shape).ravel().tolist() for part in (wanted, speed)),
            strict=True,
        )
        points = tuple(LoadPoint(*pair) for pair in pairs)
    asked = LossSettings(
        points,
        _strategies(strategies, _DEFAULT_STRATEGIES if settings is None else settings.strategies),
        _modulations(
            modulations, _DEFAULT_MODULATIONS if settings is None else settings.modulations
        ),
    )
    share = design.operation.voltage_margin if margin is None else share_kept(margin)
    inverter = replace(design.inverter, f_sw=_one_frequency(design, f_sw))
    with asked_of(design, "losses"):
        found = compare_points(
            design.machine,
            inverter,
            asked,
            i_max=design.i_max,
            options=budget_options(design),
            margin=share,
            phases=design.phase_machine,
        )
    return Losses(design, found)


def loss_map(
    design: Design,
    torques: int = 20,
    speeds: int = 24,
    *,
    strategies: Sequence[str] | None = None,
    modulations: Sequence[str] | None = None,
    f_sw: ArrayLike | None = None,
    margin: float = 0.0,
) -> LossMap:
    """Losses of all alternatives over the motoring quadrant, and who loses least where.

    Args:
        design, strategies, modulations: As for `losses`.
        torques, speeds: Numbers of grid points, 2 to 2000; the map ends at the most torque and the
            largest speed.
        f_sw: Switching frequencies in Hz, each an alternative; None for the design's.
        margin: Share of the voltage that is kept for control.

    Raises:
        InputError: A name is unknown, or more than 4 million budgets are asked for.
        NoSolutionError: The limits leave no speed at all.
    """
    require_design(design)
    _check_rules(design, strategies, modulations)
    sizes = whole(torques, "torques", 2, _MOST_CELLS), whole(speeds, "speeds", 2, _MOST_CELLS)
    settings = design.losses
    asked = Alternatives(
        _strategies(strategies, _DEFAULT_STRATEGIES if settings is None else settings.strategies),
        _modulations(
            modulations, _DEFAULT_MODULATIONS if settings is None else settings.modulations
        ),
        _frequencies(design, f_sw),
    )
    count = int(np.prod((*sizes, *asked.shape)))
    if count > _MOST_BUDGETS:
        raise InputError(
            f"loss_map: {count} budgets are requested, at most {_MOST_BUDGETS} are computed; "
            "request fewer"
        )
    with asked_of(design, "losses"):
        return LossMap(solve_map(design, asked, share_kept(margin), *sizes))


# Captures of the back-EMF, and phase currents of machines whose back-EMF is not sinusoidal.

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
        from dqforge.reports.back_emf import plot_capture

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
    step = None if interval is None else single(interval, "interval", "s")
    if step is not None and not step > 0.0:
        raise InputError(f"interval: expected a time above 0 in s, got {interval!r}")
    if len(scale) != len("abc"):
        raise InputError(f"scale: expected three factors such as (1.0, 1.0, 10.0), got {scale!r}")
    pairs = None if pole_pairs is None else whole(pole_pairs, "pole_pairs", 1, 1000)
    speed = None if omega_m is None else single(omega_m, "omega_m", "rad/s")
    options = CaptureOptions(
        connection="line-to-line" if line_to_line else "phase",
        columns=None if columns is None else list(columns),
        scale=(float(scale[0]), float(scale[1]), float(scale[2])),
        pole_pairs=pairs,
        interval=step,
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
    require_design(design)
    changes: dict[str, Any] = {}
    for name, value, unit in (
        ("torque", torque, "N m"),
        ("omega_m", omega_m, "rad/s"),
        ("ripple", ripple, "1"),
    ):
        if value is not None:
            changes[name] = single(value, name, unit)
    if not 0.0 <= changes.get("ripple", 0.0) < 1.0:
        raise InputError(f"ripple: expected a share from 0 to below 1, got {ripple!r}")
    if open_phase is not None:
        if open_phase not in {"a", "b", "c"}:
            raise InputError(f"open_phase: expected a, b or c, got {open_phase!r}")
        changes["open_phase"] = open_phase
    return Waveforms(compare_waveforms(design, replace(design.waveform, **changes)))


# A design solved whole, its C headers as texts or in a folder, and their proof.


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Solution(Result):
    """Everything that a design asks for; ``found`` holds all of it, with the evidence."""

    found: solved.Solution

    @property
    def design(self) -> Design:
        """What was solved."""
        return self.found.design

    @property
    def tuning(self) -> Tuning | None:
        """The gains, None where there are none."""
        found = self.found
        return None if found.loops is None else Tuning(found.design, found.loops, found.fixed)

    @property
    def losses(self) -> Losses | None:
        """The loss comparison, None where the design asks for none."""
        return None if self.found.losses is None else Losses(self.design, self.found.losses)

    @property
    def waveforms(self) -> Waveforms | None:
        """Phase currents, None for a sinusoidal back-EMF."""
        return None if self.found.waveforms is None else Waveforms(self.found.waveforms)

    def plain(self) -> PlainData:
        """By the keys of ``result.json``."""
        return plain_solution(self.found)


def solve(design: Design) -> Solution:
    """Solve everything that a design asks for, as `dqforge run` does before it emits.

    Args:
        design: A design file, a library drive, or one made of a machine.

    Raises:
        InputError, NoSolutionError: What it asks for is contradictory, or cannot be had; the
            message names the section.
    """
    return Solution(solved.solve(design))


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Emission(Result):
    """What is emitted of a design: ``files`` by name, the headers, their test vectors and
    ``result.json`` as texts.
    """

    design: Design
    files: Mapping[str, str]

    @property
    def header(self) -> str:
        """Text of the header with the current reference and the gains."""
        return self.files[f"{self.design.export.prefix}.h"]

    def plain(self) -> PlainData:
        """Prefix, digest of the design, and the texts by name."""
        design = self.design
        return {"prefix": design.export.prefix, "digest": design.digest, "files": dict(self.files)}

    def write(self, folder: str | Path) -> list[Path]:
        """Put all files into a folder at once, with the design that they come from, for `verify`.

        Raises:
            InputError: The folder cannot be written; it is as it was.
        """
        contents = {name: text.encode("utf-8") for name, text in self.files.items()}
        return write_output(Path(folder), RUN, contents, self.design)

    def _repr_html_(self) -> str:
        from dqforge.reports.session.result import html_table

        lines = {name: f"{text.count(chr(10))} lines" for name, text in self.files.items()}
        return html_table("Emission", {"prefix": self.design.export.prefix, **lines})


def emit(design: Design, folder: str | Path | None = None) -> Emission:
    """The C headers of a design, their test vectors, and the result that describes them.

    Args:
        design: A design file, a library drive, or one made of a machine.
        folder: Where to put them as well; None for texts alone.

    Returns:
        The same texts every time; `verify` proves them.

    Raises:
        InputError, NoSolutionError: As `solve`.
    """
    require_design(design)
    files = export_design(design, verify=False).files
    made = Emission(design, {name: content.decode("utf-8") for name, content in files.items()})
    if folder is not None:
        made.write(folder)
    return made


@dataclass(frozen=True, slots=True)
class Verified(Result):
    """Outcome of a verification that found no difference.

    ``compiled`` says what was compiled, run and compared bit for bit; ``computed_again`` what
    equals the design when it is solved again, None for an emission, which is compared text by text,
    and for a folder without its design.
    """

    compiled: Verification
    computed_again: Recomputation | None

    @property
    def compared(self) -> int:
        """Results that equal the model bit for bit."""
        return self.compiled.vectors + self.compiled.sweep

    @property
    def languages(self) -> tuple[str, ...]:
        """Standards that were compiled and run: c99, c++11."""
        return self.compiled.languages

    def plain(self) -> PlainData:
        """Counts, standards, and whether the design was solved again."""
        return {
            "compared": self.compared,
            "languages": self.languages,
            "computed_again": self.computed_again is not None,
        }


def verify(emitted: Emission | str | Path) -> Verified:
    """Compute what was emitted again from its design, compile the C, run it,
    and compare every value and every bit.

    Args:
        emitted: What `emit` gave, or a folder that it or ``dqforge run`` wrote.

    Raises:
        InputError: The folder is not what dqforge writes.
        VerificationError: Something differs, or no C compiler is there; the message names the first
            difference.
    """
    if isinstance(emitted, Emission):
        return Verified(_verified(emitted.design, emitted.files), None)
    folder = Path(emitted)
    manifest, _ = read_listed(folder)
    part = manifest.parts.get(RUN)
    again = None if part is not None and INPUT_DESIGN not in part.files else recompute(folder)
    return Verified(verify_folder(folder), again)


@on_design("export")
def _verified(design: Design, files: Mapping[str, str]) -> Verification:
    """Compare texts with those of the design, and compile and run them."""
    wanted = {
        name: content.decode("utf-8")
        for name, content in export_design(design, verify=False).files.items()
    }
    if set(files) != set(wanted):
        names = sorted(set(files) ^ set(wanted))
        raise VerificationError(
            f"the files are not those that the design gives: {', '.join(names)}"
        )
    for name, text in wanted.items():
        difference = first_difference(files[name], text)
        if difference is not None:
            raise VerificationError(f"{name}:{difference}")
    with scratch_folder() as folder:
        for name, text in files.items():
            (folder / name).write_text(text, encoding="utf-8", newline="")
        return verify_folder(folder)
