"""Operating points over torque and speed, maps of them, and what a drive can do at all."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.design import Design
from dqforge.machines.errors import InputError
from dqforge.machines.records import dataclass
from dqforge.optimizer.operating_points import characteristics as of_machines
from dqforge.optimizer.operating_points.drive_points import (
    DriveMap,
    LimitedDrive,
    Objective,
    map_within,
    points_within,
)
from dqforge.optimizer.operating_points.operating_map import DrivePoints, VoltageLimit
from dqforge.optimizer.operating_points.point_problem import Active
from dqforge.reports.operating_points.map_tables import plain_map
from dqforge.reports.plain_data import PlainData
from dqforge.reports.session.drives import DqMachine, asked_of, limited, numbers, together, whole
from dqforge.reports.session.result import DrawnResult, Result, dataset

if TYPE_CHECKING:
    from matplotlib.figure import Figure


_MOST_CELLS = 2000


_UNITS = {
    "torque_request": "N m",
    "torque": "N m",
    "i_d": "A",
    "i_q": "A",
    "voltage": "V",
    "copper_loss": "W",
    "loss": "W",
    "power": "W",
    "efficiency": "1",
}


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class OperatingPoints(Result):
    """Currents of least loss, arrays of the common shape of torque and speed.

    ``torque_request`` and ``torque`` in N m (equal where ``reached``), ``omega_m`` in rad/s
    (mechanical), ``i_d``, ``i_q`` in A and ``voltage`` in V (peak of phase), ``copper_loss`` and
    ``loss`` in W: of the machine, and of the inverter where its device is known. ``power`` is the
    mechanical power in W, ``efficiency`` from 0 to 1 that of the torque that is made, nan without
    power. ``held_by`` names what limits a point: none, voltage, current, both, mtpv, unreachable or
    data. ``kkt_residual`` is the largest relative violation of the conditions of an optimum;
    ``extrapolated`` is true beyond the data of a flux map. ``limit`` is the voltage limit,
    ``objective`` what was minimised.
    """

    torque_request: FloatArray
    torque: FloatArray
    omega_m: FloatArray
    i_d: FloatArray
    i_q: FloatArray
    voltage: FloatArray
    copper_loss: FloatArray
    loss: FloatArray
    power: FloatArray
    efficiency: FloatArray
    held_by: NDArray[np.str_]
    reached: NDArray[np.bool_]
    kkt_residual: FloatArray
    extrapolated: NDArray[np.bool_]
    limit: VoltageLimit
    objective: Objective

    def plain(self) -> PlainData:
        """By the keys of ``dqforge mtpa --speed --json``."""
        limit = self.limit
        return {
            "limit": {
                "modulation": limit.modulation,
                "topology": limit.topology,
                "v_dc_V": limit.v_dc,
                "margin": limit.margin,
                "v_max_V": limit.v_max,
            },
            "objective": self.objective,
            "points": {
                "torque_request_Nm": self.torque_request,
                "torque_Nm": self.torque,
                "omega_m_rad_per_s": self.omega_m,
                "i_d_A": self.i_d,
                "i_q_A": self.i_q,
                "current_A": np.hypot(self.i_d, self.i_q),
                "voltage_V": self.voltage,
                "held_by": self.held_by,
                "reached": self.reached,
                "kkt_residual": self.kkt_residual,
                "extrapolated": self.extrapolated,
            },
            "losses": {"copper_W": self.copper_loss, "total_W": self.loss},
            "power_W": self.power,
            "efficiency": self.efficiency,
        }

    def to_xarray(self) -> Any:
        """An xarray.Dataset over torque and omega_m, of points that were asked for on a grid,
        shape (N, M).

        Raises:
            InputError: xarray is not installed, or the points are no grid of torques by speeds.
        """
        wanted, speed = self.torque_request, self.omega_m
        if wanted.ndim != 2 or np.any(wanted != wanted[:, :1]) or np.any(speed != speed[:1]):
            raise InputError(
                "to_xarray needs a grid; ask with torque[:, None] and omega_m[None, :]"
            )
        return _grid_dataset(self, wanted[:, 0], speed[0])


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class OperatingMap(DrawnResult):
    """Operating points of the motoring quadrant on a grid of N torques by M speeds,
    and the limits around them.

    ``torque`` in N m, shape (N,), from zero to the most; ``omega_m`` in rad/s, shape (M,), from
    standstill to the largest speed. ``points`` have arrays of shape (N, M). ``found`` holds the
    characteristic figures, the envelope over speed and the loci in the plane of currents.
    """

    torque: FloatArray
    omega_m: FloatArray
    points: OperatingPoints
    found: DriveMap

    @property
    def efficiency(self) -> FloatArray:
        """From 0 to 1, shape (N, M); nan without power and where the torque is out of reach."""
        return self.points.efficiency

    def plain(self) -> PlainData:
        """By the keys of ``dqforge mtpa --map --json``."""
        found = self.found
        plain = plain_map(found.figures, found.envelope, found.chart, found.loci, found.drive.limit)
        return plain | {"objective": found.objective}

    def figure(self) -> Figure:
        """Efficiency over torque and speed, with the envelope."""
        from dqforge.reports.operating_points.figures import plot_operating_map

        return plot_operating_map(self.found.figures, self.found.envelope, self.found.chart)

    def to_xarray(self) -> Any:
        """An xarray.Dataset over torque and omega_m.

        Raises `InputError` where xarray is not installed.
        """
        return _grid_dataset(self.points, self.torque, self.omega_m)


@dataclass(frozen=True, slots=True)
class Characteristics(Result):
    """What a drive can do at all.

    ``torque_max`` in N m at low speed; ``base_speed`` in rad/s (mechanical), where it meets the
    voltage limit; ``power_max`` in W at ``power_speed`` in rad/s; ``characteristic_current`` in A,
    whose d-axis flux cancels the magnets (None without magnets, or beyond a map); ``speed_max`` in
    rad/s, up to which the voltage limit can be kept (None: no end). ``held`` names figures that the
    data of a flux map hold: more may lie beyond them.
    """

    torque_max: float
    base_speed: float
    power_max: float
    power_speed: float
    characteristic_current: float | None
    speed_max: float | None
    held: tuple[str, ...]
    limit: VoltageLimit

    def plain(self) -> PlainData:
        """By the keys of ``characteristics`` in ``dqforge mtpa --map --json``."""
        return {
            "torque_max_Nm": self.torque_max,
            "base_speed_rad_per_s": self.base_speed,
            "power_max_W": self.power_max,
            "power_speed_rad_per_s": self.power_speed,
            "characteristic_current_A": self.characteristic_current,
            "speed_max_rad_per_s": self.speed_max,
            "held_by_data": self.held,
        }


def _grid_dataset(points: OperatingPoints, torque: FloatArray, omega_m: FloatArray) -> Any:
    values = {
        name: (getattr(points, name), unit) for name, unit in _UNITS.items() if name != "torque"
    }
    values |= {"torque_made": (points.torque, "N m"), "held_by": (points.held_by, "1")}
    limit = points.limit
    about = {"modulation": limit.modulation, "v_dc_V": limit.v_dc, "v_max_V": limit.v_max}
    return dataset({"torque": (torque, "N m"), "omega_m": (omega_m, "rad/s")}, values, about)


def _shaped(
    found: DrivePoints, shape: tuple[int, ...], drive: LimitedDrive, objective: Objective
) -> OperatingPoints:
    """Points of shape (N,) as arrays of the shape that was asked for."""
    points, losses = found.points, found.losses
    held_by = np.array([Active(int(code)).label for code in points.active], dtype=np.str_)
    return OperatingPoints(
        torque_request=points.torque_request.reshape(shape),
        torque=points.torque.reshape(shape),
        omega_m=points.omega_m.reshape(shape),
        i_d=points.i_d.reshape(shape),
        i_q=points.i_q.reshape(shape),
        voltage=points.voltage.reshape(shape),
        copper_loss=losses.copper.reshape(shape),
        loss=losses.total.reshape(shape),
        power=found.power.reshape(shape),
        efficiency=found.efficiency.reshape(shape),
        held_by=held_by.reshape(shape),
        reached=points.reached.reshape(shape),
        kkt_residual=points.kkt_residual.reshape(shape),
        extrapolated=points.extrapolated.reshape(shape),
        limit=drive.limit,
        objective=objective,
    )


def _objective(name: str) -> Objective:
    known = get_args(Objective)
    if name not in known:
        raise InputError(f"objective: expected {' or '.join(known)}, got {name!r}")
    return "copper" if name == "copper" else "total"


def operating_points(
    drive: Design | DqMachine,
    torque: ArrayLike,
    omega_m: ArrayLike = 0.0,
    *,
    v_dc: float | None = None,
    i_max: float | None = None,
    modulation: str = "svpwm",
    margin: float = 0.0,
    objective: str = "copper",
) -> OperatingPoints:
    """Currents of least loss for torques and speeds, within the current limit and the voltage
    limit.

    MTPA where nothing limits, field weakening and MTPV where the voltage does.

    Args:
        drive: A design, or a machine alone.
        torque: In N m, any sign and shape.
        omega_m: Mechanical speed in rad/s, any sign; broadcast with the torque, so that ``torque[:,
            None]`` and ``omega_m[None, :]`` make a grid.
        v_dc: Voltage of the dc link in V; None takes the design's.
        i_max: Current limit in A (peak of phase); None takes the design's or the machine's.
        modulation: Modulator whose linear range limits the voltage: ``spwm``, ``svpwm``, ``dpwm1``,
            ...
        margin: Share of that voltage, 0 to below 0.9, that is kept for control.
        objective: ``copper``, or ``total`` for the loss of machine and inverter together.

    Returns:
        Arrays of the common shape. Where the torque cannot be had, the nearest that can,
        with ``reached`` false.

    Raises:
        InputError: A number is not finite, shapes do not fit, or a machine alone comes without
            v_dc.
    """
    wanted, speed = numbers(torque, "torque", "N m"), numbers(omega_m, "omega_m", "rad/s")
    shape, minimised = together({"torque": wanted, "omega_m": speed}), _objective(objective)
    bounded = limited(drive, v_dc=v_dc, i_max=i_max, modulation=modulation, margin=margin)
    with asked_of(drive, "operation"):
        found = points_within(bounded, wanted, speed, minimised)
    return _shaped(found, shape, bounded, minimised)


def operating_map(
    drive: Design | DqMachine,
    torques: int = 40,
    speeds: int = 60,
    *,
    v_dc: float | None = None,
    i_max: float | None = None,
    modulation: str = "svpwm",
    margin: float = 0.0,
    objective: str = "copper",
) -> OperatingMap:
    """Operating points from standstill to the largest speed and from no torque to the most,
    with the limits.

    Args:
        drive, v_dc, i_max, modulation, margin, objective: As for `operating_points`.
        torques, speeds: Numbers of grid points, 2 to 2000. The largest speed is the machine's, or
            three times the base speed.

    Raises:
        InputError: As `operating_points`.
        NoSolutionError: The resistance drop takes the whole voltage even at standstill.
    """
    sizes = whole(torques, "torques", 2, _MOST_CELLS), whole(speeds, "speeds", 2, _MOST_CELLS)
    minimised = _objective(objective)
    bounded = limited(drive, v_dc=v_dc, i_max=i_max, modulation=modulation, margin=margin)
    with asked_of(drive, "operation"):
        found = map_within(bounded, *sizes, minimised)
    chart = found.chart
    power = chart.points.torque * chart.points.omega_m
    points = DrivePoints(chart.points, chart.losses, power, chart.efficiency.ravel())
    shaped = _shaped(points, sizes, bounded, minimised)
    return OperatingMap(chart.torque, chart.omega_m, shaped, found)


def characteristics(
    drive: Design | DqMachine,
    *,
    v_dc: float | None = None,
    i_max: float | None = None,
    modulation: str = "svpwm",
    margin: float = 0.0,
) -> Characteristics:
    """Most torque, base speed, most power, characteristic current and largest speed of a drive.

    Args:
        drive, v_dc, i_max, modulation, margin: As for `operating_points`.

    Raises:
        InputError: As `operating_points`.
    """
    bounded = limited(drive, v_dc=v_dc, i_max=i_max, modulation=modulation, margin=margin)
    with asked_of(drive, "operation"):
        found = of_machines.characteristics(bounded.machine, bounded.limit.v_max, bounded.i_max)
    return Characteristics(
        found.torque_max,
        found.base_speed,
        found.power_max,
        found.power_speed,
        found.characteristic_current,
        found.speed_max,
        found.held,
        bounded.limit,
    )
