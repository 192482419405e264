"""What a question is asked of: a design, or a machine alone with its limits;
and the checks of what is asked.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design import catalogue
from dqforge.machines.design.catalogue import load_design as load_file
from dqforge.machines.design.design import Design
from dqforge.machines.design.from_machine import python_values
from dqforge.machines.design.numerical import located, on_design
from dqforge.machines.devices.inverter import Inverter
from dqforge.machines.dq_machines.flux_map import SaturatedMachine
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.errors import DqforgeError, InputError, NoSolutionError
from dqforge.machines.files.positioned_yaml import written
from dqforge.machines.modulation.registry import MODULATORS
from dqforge.machines.names import ModulationName
from dqforge.machines.records import dataclass
from dqforge.optimizer.certificates.current_reference import Certificate
from dqforge.optimizer.certificates.current_reference import certify as prove
from dqforge.optimizer.current_reference.fit import (
    Alternative,
    alternatives,
    signed_designs,
    signed_reference,
)
from dqforge.optimizer.current_reference.forms import ReferenceErrors
from dqforge.optimizer.current_reference.solve import FitChoice, Trial, solve_fit
from dqforge.optimizer.field_weakening.fit import WeakeningFit, solve_weakening
from dqforge.optimizer.operating_points import characteristics as of_machines
from dqforge.optimizer.operating_points.characteristics import (
    DriveMap,
    DrivePoints,
    LimitedDrive,
    Objective,
    VoltageLimit,
    limited_drive,
    map_within,
    points_within,
    voltage_limit,
)
from dqforge.optimizer.operating_points.mtpa_locus import Active
from dqforge.optimizer.operating_points.solve import current_choice
from dqforge.optimizer.solution import NegativeHalf, solve_negative
from dqforge.reports.current_reference.plain import plain_fit, plain_negative
from dqforge.reports.operating_points.map_tables import plain_map
from dqforge.reports.plain_data import PlainData
from dqforge.reports.session.result import DrawnResult, Result, dataset
from dqforge.reports.single_headers.field_weakening import plain_weakening_fit

if TYPE_CHECKING:
    from matplotlib.figure import Figure


# Switching frequency in Hz of an inverter of which only the voltage counts; nothing depends on it.
DqMachine = LinearMachine | SaturatedMachine
_NO_CARRIER = 10e3

# What a flux map may say that no machine has; all else is checked where a machine is made.
_MOST_MARGIN = 0.9
_OF_A_MAP = ("l_d", "l_q", "psi_pm")


def load_design(source: str | Path, changes: Mapping[str, Any] | None = None) -> Design:
    """The design in a file, or that of a library drive or motor by its name.

    Args:
        source: Path of a design file, or one of `library`; a file of that name comes first.
        changes: Keys that are set instead of what the file says, as by ``--set``: dotted keys with
            numbers in SI units, names, lists or mappings, such as ``{"fit.degree": 3,
            "inverter.v_dc": 48.0}``.

    Raises:
        InputError: There is neither, or the content is wrong, with file, line and column.
    """
    name = str(source)
    given = {} if changes is None else changes
    settings = [f"{key}={written(python_values(value))}" for key, value in given.items()]
    with in_python():
        if not Path(source).exists() and catalogue.is_known(name):
            return catalogue.load(name, settings)
        return load_file(source, settings)


def _with_changes(text: str) -> str:
    option = catalogue.OPTION
    return text.replace(f"{option} ", "changes: ").replace(option, "changes")


@contextmanager
def in_python() -> Iterator[None]:
    """Block whose messages name ``changes`` where the command line has its option."""
    try:
        yield
    except DqforgeError as error:
        for one in (error, *error.others):
            one.message = _with_changes(one.message)
            one.source = one.source and _with_changes(one.source)
            one.args = (one.message,)
        raise


def library() -> tuple[str, ...]:
    """Names of the drives that come with the package, then of the motors, for `load_design`."""
    return (*catalogue.names(), *catalogue.motors())


def limited(
    drive: Design | DqMachine,
    *,
    v_dc: float | None,
    i_max: float | None,
    modulation: str,
    margin: float,
) -> LimitedDrive:
    """A design or a machine within its limits.

    Limits that are given count in place of the design's.

    Raises:
        InputError: A limit is missing, or is no number that can be one.
    """
    names = tuple(MODULATORS)
    if modulation not in names:
        raise InputError(f"modulation: expected one of {', '.join(names)}, got {modulation!r}")
    name: ModulationName = next(name for name in names if name == modulation)
    margin = share_kept(margin)
    v_dc, i_max = _positive(v_dc, "v_dc", "V"), _positive(i_max, "i_max", "A")
    if isinstance(drive, Design):
        inverter = drive.inverter if v_dc is None else replace(drive.inverter, v_dc=v_dc)
        with asked_of(drive, "operation"):
            found = limited_drive(replace(drive, inverter=inverter), name, margin)
        return found if i_max is None else replace(found, i_max=i_max)
    check_machine(drive)
    if v_dc is None:
        raise InputError(
            "v_dc: a machine alone has no voltage limit; give v_dc in V, or a design that has one"
        )
    inverter = Inverter(v_dc=v_dc, f_sw=_NO_CARRIER)
    limit = voltage_limit(inverter, name, margin)
    return LimitedDrive(drive, inverter, limit, drive.i_max if i_max is None else i_max)


def _positive(value: float | None, name: str, unit: str) -> float | None:
    """A positive number, None where none was given."""
    if value is None:
        return None
    found = single(value, name, unit)
    if not found > 0.0:
        raise InputError(f"{name}: expected a positive number in {unit}, got {value!r}")
    return found


def share_kept(margin: float) -> float:
    """The share of the voltage that is kept for control; raises `InputError` where it is none."""
    found = single(margin, "margin", "1")
    if not 0.0 <= found < _MOST_MARGIN:
        raise InputError(
            f"margin: expected a share of the voltage from 0 to below {_MOST_MARGIN}, got "
            f"{margin!r}"
        )
    return found


def check_machine(machine: DqMachine) -> None:
    """Refuse what is no machine: another type, or a flux map that none can have."""
    if not isinstance(machine, LinearMachine | SaturatedMachine):
        raise InputError(
            "drive: expected a Design, a LinearMachine or a SaturatedMachine, got "
            f"{type(machine).__name__}"
        )
    for name in _OF_A_MAP:
        value = getattr(machine, name)
        least = 0.0 if name == "psi_pm" else np.nextafter(0.0, 1.0)
        if not (np.isfinite(value) and value >= least):
            wanted = "zero or a positive number" if least == 0.0 else "a positive number"
            raise InputError(f"{name}: expected {wanted} in SI units, got {value!r}")


@contextmanager
def asked_of(drive: Design | DqMachine, section: str) -> Iterator[None]:
    """Block that answers a question: numerical trouble ends in one line,
    with its place where the design has a file.
    """
    with located(drive.places if isinstance(drive, Design) else None, section):
        yield


def numbers(values: ArrayLike, name: str, unit: str) -> FloatArray:
    """An array of finite numbers, any shape.

    Raises:
        InputError: It holds texts, or what is not finite.
    """
    try:
        array = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError(f"{name}: expected numbers in {unit}, got {_said(values)}") from None
    if not np.all(np.isfinite(array)):
        place = tuple(np.argwhere(~np.isfinite(array))[0].tolist())
        where = f" at index {place}" if array.ndim else ""
        raise InputError(f"{name}: expected finite numbers in {unit}, got {array[place]}{where}")
    return array


def single(value: ArrayLike, name: str, unit: str, instead: str = "") -> float:
    """One finite number, also as an array of one; `instead` says what takes several.

    Raises:
        InputError: There are several, or it is no number.
    """
    array = numbers(value, name, unit)
    if array.size != 1:
        raise InputError(
            f"{name}: expected one number in {unit}, got {array.size}{instead and '; ' + instead}"
        )
    return float(array.item())


def _said(values: object) -> str:
    return repr(values) if isinstance(values, str) else f"{type(values).__name__}"


def together(values: Mapping[str, FloatArray]) -> tuple[int, ...]:
    """The common shape of arrays by their names.

    Raises:
        InputError: They have none.
    """
    try:
        return np.broadcast_shapes(*(array.shape for array in values.values()))
    except ValueError:
        shapes = " and ".join(f"{name} {array.shape}" for name, array in values.items())
        first, second = values
        raise InputError(
            f"{shapes} have no common shape; for a grid write {first}[:, None] and {second}[None, "
            ":]"
        ) from None


def whole(value: Any, name: str, least: int, most: int) -> int:
    """A whole number within bounds; raises `InputError` otherwise."""
    number = value.item() if isinstance(value, np.generic) else value
    if isinstance(number, bool) or not isinstance(number, int) or not least <= number <= most:
        raise InputError(f"{name}: expected a whole number from {least} to {most}, got {value!r}")
    return number


# Operating points over torque and speed, maps of them, and what a drive can do at all.

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
class OperatingPoints(DrawnResult):
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

    def shown(self) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
        """Torque, speed, currents, voltage and losses of each point."""
        headings = (
            *("torque N m", "speed rad/s", "i_d A", "i_q A", "voltage V"),
            *("copper W", "loss W", "limited by"),
        )
        names = ("torque", "omega_m", "i_d", "i_q", "voltage", "copper_loss", "loss")
        columns = [
            [f"{number + 0.0:.5g}" for number in np.ravel(getattr(self, name)).tolist()]
            for name in names
        ]
        return headings, list(zip(*columns, self.held_by.ravel().tolist(), strict=True))

    def figure(self) -> Figure:
        """The points in the plane of the currents, those of one speed joined."""
        from dqforge.reports.operating_points.figures import plot_points

        return plot_points(self.i_d, self.i_q, self.torque, self.omega_m)

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


# Current references fitted for the firmware, and proven bounds of what they err by.


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Fit(DrawnResult):
    """The current reference of a design, as the firmware evaluates it.

    ``choice`` holds the fit and the forms that were tried for a budget, ``alternatives`` other
    forms with their errors, ``negative`` the reference of negative torques where the halves of a
    machine are kept apart, ``weakening`` that over torque and speed where the design asks for one.
    ``certificate`` holds proven bounds once `certify` was asked.
    """

    design: Design
    choice: FitChoice
    alternatives: tuple[Alternative, ...]
    negative: NegativeHalf | None = None
    weakening: WeakeningFit | None = None
    certificate: Certificate | None = None

    @property
    def form(self) -> str:
        """Name of the form that is emitted."""
        return self.choice.fit.form

    @property
    def torque_max(self) -> float:
        """End of the domain in N m."""
        return self.choice.fit.torque_max

    @property
    def errors(self) -> ReferenceErrors:
        """Largest errors over the domain, found by sampling, in the arithmetic that is emitted."""
        return self.choice.fit.errors

    @property
    def trials(self) -> tuple[Trial, ...]:
        """Forms that were tried for a budget, in order of their cost."""
        return self.choice.trials

    def currents(self, torque: ArrayLike) -> tuple[NDArray[Any], NDArray[Any]]:
        """What the firmware computes in its own arithmetic: (i_d, i_q) in A for torques in N m,
        any sign and shape.
        """
        wanted = numbers(torque, "torque", "N m").astype(np.float32)
        positive = self.choice.fit
        emitted = (
            positive.reference
            if self.negative is None
            else signed_reference(positive, self.negative.fit)
        )
        found: tuple[NDArray[Any], NDArray[Any]] = emitted.currents(wanted.ravel())
        return found[0].reshape(wanted.shape), found[1].reshape(wanted.shape)

    def plain(self) -> PlainData:
        """By the keys of ``dqforge fit --json``."""
        choice = self.choice
        return {
            "fit": plain_fit(
                choice.fit, self.alternatives, choice.trials, self.certificate, choice.data
            ),
            **plain_negative(self.negative),
            "weakening": plain_weakening_fit(self.weakening),
        }

    def figure(self) -> Figure:
        """Currents, their errors, and what these cost in torque and loss."""
        from dqforge.reports.current_reference.figures import plot_fit

        return plot_fit(signed_designs(self.design)[0], self.choice.fit)


@on_design("fit")
def fit(design: Design) -> Fit:
    """Fit the current references of a design as its section ``fit`` asks.

    Args:
        design: With the form, or the budget that the cheapest one must keep.

    Raises:
        InputError, NoSolutionError: The form does not suit the machine, or no form keeps the
            budget.
    """
    positive = signed_designs(design)[0]
    chosen = solve_fit(positive)
    rows = alternatives(current_choice(positive), chosen.fit)
    return Fit(design, chosen, rows, solve_negative(design), solve_weakening(design))


def certify(asked: Design | Fit) -> Fit:
    """Bounds of the errors of a current reference, proven for every torque of its domain,
    rounding included.

    Args:
        asked: A design, or the fit of one.

    Returns:
        The fit with its ``certificate``.

    Raises:
        NoSolutionError: No bounds could be proven.
    """
    found = asked if isinstance(asked, Fit) else fit(asked)
    proof = _proof(found.design, found)
    if proof is None:
        raise NoSolutionError(
            "fit: no bounds of the errors could be proven; those found by sampling are in "
            "fit().errors"
        )
    return replace(found, certificate=proof)


@on_design("fit")
def _proof(design: Design, found: Fit) -> Certificate | None:
    chosen = found.choice.fit
    return prove(current_choice(signed_designs(design)[0]), chosen.reference, chosen.errors)
