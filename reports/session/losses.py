"""Losses of strategies, modulators and switching frequencies, at points and over maps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.design import Design
from dqforge.machines.design.settings import AnyStrategy, LoadPoint, LossSettings, LossStrategy
from dqforge.machines.errors import InputError
from dqforge.machines.modulation.registry import MODULATORS
from dqforge.machines.names import ModulationName
from dqforge.machines.records import dataclass
from dqforge.optimizer.losses.drive_comparison import Alternatives
from dqforge.optimizer.losses.loss_map import LossMap as FoundMap
from dqforge.optimizer.losses.loss_map import budget_options, solve_map
from dqforge.optimizer.losses.point_comparison import LossComparison, compare_points
from dqforge.reports.losses.map_tables import plain_map
from dqforge.reports.losses.plain import plain_losses
from dqforge.reports.plain_data import PlainData
from dqforge.reports.session.drives import asked_of, numbers, together, whole
from dqforge.reports.session.result import DrawnResult, dataset

if TYPE_CHECKING:
    from matplotlib.figure import Figure


_DEFAULT_STRATEGIES: tuple[LossStrategy, ...] = ("mtpa",)


_DEFAULT_MODULATIONS: tuple[ModulationName, ...] = ("spwm", "svpwm", "dpwm1", "ddt-gdpwm")


_MOST_CELLS = 2000


_MOST_BUDGETS = 4_000_000


_MOST_MARGIN = 0.9


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
    def total(self) -> FloatArray:
        """Total loss in W, shape (S, M, P); nan where the torque is out of reach."""
        return self.found.budget.total

    @property
    def usable(self) -> NDArray[np.bool_]:
        """Where torque and voltage are made and every temperature is permitted, shape (S, M, P)."""
        return self.found.usable

    @property
    def best(self) -> tuple[tuple[AnyStrategy, ModulationName] | None, ...]:
        """Who loses least at each point, None where none is usable."""
        return self.found.best_labels

    def plain(self) -> PlainData:
        """By the keys of ``losses`` in ``result.json``."""
        found = plain_losses(self.found)
        return {} if found is None else found

    def figure(self) -> Figure:
        """Bars of each kind of loss."""
        from dqforge.reports.losses.figures import plot_losses

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
        """Index of the alternative that loses least, shape (N, M), -1 where none can be used."""
        return self.found.comparison.best.reshape(self.torque.size, self.omega_m.size)

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


def _margin(margin: float) -> float:
    if not 0.0 <= margin < _MOST_MARGIN:
        raise InputError(
            f"margin: expected a share of the voltage from 0 to below {_MOST_MARGIN}, got "
            f"{margin!r}"
        )
    return float(margin)


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
        f_sw: Switching frequency in Hz; None for the design's.
        margin: Share of the voltage that is kept for control; None for the design's.

    Raises:
        InputError: A name is unknown, a number is not finite, or the design names no points and
            none are given.
    """
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
    share = design.operation.voltage_margin if margin is None else _margin(margin)
    inverter = replace(design.inverter, f_sw=_frequencies(design, f_sw)[0])
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
            f"loss_map: {count} budgets are asked for, at most {_MOST_BUDGETS} are computed; ask "
            "for fewer"
        )
    with asked_of(design, "losses"):
        return LossMap(solve_map(design, asked, _margin(margin), *sizes))
