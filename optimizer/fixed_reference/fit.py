"""The smallest integer reference that keeps its errors, and its evidence."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.design import Design
from dqforge.machines.design.numerical import on_design
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.machines.records import dataclass
from dqforge.optimizer.current_reference.forms import FIXED_WIDTHS
from dqforge.optimizer.field_weakening.form import WeakeningRegion
from dqforge.optimizer.field_weakening.voltage_region import LEAST_VOLTAGE, VoltageRegion
from dqforge.optimizer.fixed_control.ranges import codes, require
from dqforge.optimizer.fixed_reference.mesh import CurrentMesh, VoltageScale
from dqforge.optimizer.loops.integer_gains import FixedGain, quantise
from dqforge.optimizer.operating_points.current_choice import CurrentChoice
from dqforge.optimizer.operating_points.points import OptimalPoints, optimal_points
from dqforge.optimizer.steps.integer_arithmetic import BoolArray, CodeArray, Integers, Ranges, Reach

if TYPE_CHECKING:
    from dqforge.optimizer.current_reference.fit import ReferenceFit
    from dqforge.optimizer.field_weakening.fit import WeakeningFit


_LINE_ROWS = (1, 2, 4, 8, 16, 32, 64, 128)

# Share of the largest torque by which a reference of the torque alone may err, where the float32
# reference does not err by more.
_LINE_ERROR = 0.001

# Cells along torque and flux linkage that are tried.
_SHAPES = ((8, 4), (16, 4), (16, 8), (32, 4), (32, 8), (32, 16), (64, 16))
_HALVINGS = 60

# Share of the least flux linkage by which the mesh goes below it, so that what is rounded still
# lies inside.
_MARGIN = 0.005


@dataclass(frozen=True, slots=True)
class FixedReferenceFit:
    """An integer reference with its evidence.

    Args:
        reference: The integers.
        errors: Largest errors found.
        proven: Bounds of what limits are exceeded by.
        reaches: Proven range of every product and sum, for any codes.
        speed: Largest mechanical speed in rad/s at the design's voltage for which the errors hold;
            None where the voltage limits nothing.
    """

    reference: CurrentMesh
    errors: MeshErrors
    proven: ProvenExcess
    reaches: tuple[Reach, ...]
    speed: float | None

    @property
    def fullest(self) -> Reach:
        """The quantity that comes nearest to its word's end."""
        return max(self.reaches, key=lambda reach: reach.share)


def _end(design: Design, asked: float, width: int) -> float:
    """Largest torque in N m: the one asked for, as far as full scale holds it."""
    return min(asked, design.control.bases.torque * (1.0 - 2.0 ** (1 - width)))


def fit_line(
    design: Design, choice: CurrentChoice, end: float, permitted: float, width: int
) -> FixedReferenceFit:
    """Reference of the torque alone.

    Args:
        design: Machine and bases.
        choice: The exact currents.
        end: Largest torque in N m.
        permitted: Torque error over the largest torque that other references of the design have.
        width: Bits of a code.

    Raises:
        NoSolutionError: Its torques are too small a part of full scale.
    """
    end = _end(design, end, width)
    worst = max(permitted, _LINE_ERROR)
    found: FixedReferenceFit | None = None
    for nodes in _each(lambda rows: line_nodes(choice.currents, end, rows), _LINE_ROWS):
        try:
            mesh = in_integers(design, nodes, width, (0, 1))
        except NoSolutionError:
            if found is not None:
                return found
            raise
        errors = line_errors(design, choice, mesh)
        proven = proven_excess(design, mesh, None)
        found = FixedReferenceFit(mesh, errors, proven, mesh_ranges(mesh), None)
        if errors.torque_relative <= worst:
            return found
    assert found is not None
    return found


def _each(make: Callable[[int], Nodes], sizes: tuple[int, ...]) -> Iterator[Nodes]:
    for size in sizes:
        yield make(size)


def _least_flux(domain: VoltageRegion) -> float:
    """Flux linkage in Wb that is left for the largest torque at the least voltage and the speed in
    proportion, motoring, where the resistance weighs most.
    """
    region, omega_e = domain.flux, LEAST_VOLTAGE * domain.omega_e
    whole = domain.v_max / domain.omega_e
    per_torque = domain.per_torque / omega_e
    reserve = (domain.largest_drop / omega_e) ** 2
    low, high = 0.0, region.flux_min
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        torque = _torque_within(region, middle)
        enough = middle**2 + per_torque * torque + reserve >= whole**2
        low, high = (low, middle) if enough and torque > 0.0 else (middle, high)
    below = high * (1.0 - _MARGIN)
    return below if _torque_within(region, below) > 0.0 else high


def _torque_within(region: WeakeningRegion, level: float) -> float:
    """Largest torque in N m within a flux linkage in Wb; 0 where no current keeps that."""
    points = region.points(np.full(1, 2.0 * region.torque_max), np.array([level]))
    held = float(region.flux(points.i_d, points.i_q)[0]) <= level * (1.0 + 1e-6)
    return float(points.torque[0]) if held else 0.0


def fit_mesh(
    design: Design, domain: VoltageRegion, end: float, width: int, dc: tuple[int, int]
) -> FixedReferenceFit:
    """Smallest reference over torque, voltage and speed that keeps the errors of the design.

    Args:
        design: Machine, bases, voltage limit and budget.
        domain: Torque, voltage and speed.
        end: Largest torque in N m.
        width: Bits of a code.
        dc: Scale of the dc link and its least code, as `FixedControl` has them.

    Raises:
        NoSolutionError: No size keeps the permitted errors, or a scale is missing.
    """
    settings = design.weakening
    if settings is None:
        raise InputError("there is no section field_weakening")
    end = _end(design, min(end, domain.flux.torque_max), width)
    region: WeakeningRegion = replace(domain.flux, flux_min=_least_flux(domain))
    best, targets, ways = np.inf, None, row_ways(region, end)
    for shape in _SHAPES:
        mesh = in_integers(design, mesh_nodes(region, ways, shape), width, dc)
        if targets is None:
            targets = weakened_targets(design, mesh, settings.omega_m)
        errors = weakened_errors(design, mesh, targets)
        over = errors.voltage_excess
        assert over is not None
        ratio = max(
            errors.torque_relative / settings.torque_error,
            max(over, errors.current_excess) / settings.voltage_excess,
        )
        if ratio <= 1.0:
            proven = proven_excess(design, mesh, settings.omega_m)
            reaches = mesh_ranges(mesh)
            return FixedReferenceFit(mesh, errors, proven, reaches, settings.omega_m)
        best = min(best, ratio)
    raise NoSolutionError(
        f"field_weakening: no size in integers of {width} bits keeps the permitted errors "
        f"({best:.3g} times those at best); raise torque_error or voltage_excess, or write "
        "export.control: float32"
    )


# Errors of integer references against exact operating points, in amperes, torque and voltage.

_TORQUES, _SPEEDS = 25, 24
_VOLTAGES = (1.0, LEAST_VOLTAGE, 0.9, 1.1)
_LOADED = 0.05  # Share of the largest torque from which the loss above the least is told.
_LINE_POINTS = 20_001


@dataclass(frozen=True, slots=True)
class MeshErrors:
    """Largest errors of an integer reference, found by sampling.

    Args:
        torque: Torque made less the one asked for, or less the largest one that can be had, in N m.
        torque_relative: The same over the largest torque.
        current: Distance from the exact currents in A.
        current_excess: Magnitude of the current beyond its limit, relative to it.
        voltage_excess: Phase voltage with its resistance drop beyond the limit, relative to it;
            None where the voltage limits nothing.
        loss_relative: Copper loss above the least, where the torque can be had.
        samples: How many points were looked at.
    """

    torque: float
    torque_relative: float
    current: float
    current_excess: float
    voltage_excess: float | None
    loss_relative: float
    samples: int


@dataclass(frozen=True, slots=True)
class CodePoints:
    """Codes of torque, dc link and speed, shape (N,)."""

    torque: CodeArray
    v_dc: CodeArray
    omega_m: CodeArray


def physical(mesh: CurrentMesh, codes: CodeArray, base: float) -> FloatArray:
    """What codes stand for, in the unit of the base."""
    return np.asarray(codes * (base / 2 ** (mesh.width - 1)), dtype=np.float64)


def mesh_currents(mesh: CurrentMesh, points: CodePoints) -> tuple[FloatArray, FloatArray]:
    """(i_d, i_q) in A that the integers give, shape (N,)."""
    found = mesh.currents(Integers(), points.torque, points.v_dc, points.omega_m)
    i_d, i_q = (physical(mesh, part, mesh.bases[0]) for part in (found.x, found.y))
    return i_d, i_q


def line_errors(design: Design, choice: CurrentChoice, mesh: CurrentMesh) -> MeshErrors:
    """Errors where the voltage limits nothing: all codes of the torque in 16 bits, else some."""
    count = min(mesh.end + 1, 2**16 if mesh.width == 16 else _LINE_POINTS)
    codes = np.rint(np.linspace(0.0, mesh.end, count)).astype(np.int64)
    still = np.zeros_like(codes)
    i_d, i_q = mesh_currents(mesh, CodePoints(codes, still, still))
    torque = physical(mesh, codes, mesh.bases[3])
    exact = choice.currents(torque)
    # The end of the torque may round to a code above it.
    best = np.minimum(torque, choice.largest_torque())
    return _errors(design, (i_d, i_q), exact, best, best >= torque, None)


def weakened_points(design: Design, mesh: CurrentMesh, speed: float) -> CodePoints:
    """Torques and speeds of both signs, at several voltages; the largest speed in rad/s
    (mechanical) goes with the voltage.
    """
    _, voltage, omega, _ = mesh.bases
    one, scale = 2 ** (mesh.width - 1), mesh.voltage
    assert scale is not None
    share = 0.5 - 0.5 * np.cos(np.linspace(0.0, np.pi, _TORQUES))
    signed = np.concatenate([-share[:0:-1], share, [1.05, -1.05]]) * mesh.end
    along = np.linspace(-1.0, 1.0, 2 * _SPEEDS + 1)
    mesh_v, mesh_w, mesh_t = np.meshgrid(np.array(_VOLTAGES), along, signed, indexing="ij")
    link = np.ceil(mesh_v * design.v_max / voltage / scale.limit.value * one)
    v_dc = np.clip(link, -one, one - 1).astype(np.int64)
    # A voltage beyond full scale is not there, nor is the speed that goes with it.
    turning = np.trunc(phase_limit(mesh, v_dc) / design.v_max * mesh_w * speed / omega * one)
    t, w = (np.clip(part, -one, one - 1).astype(np.int64) for part in (np.rint(mesh_t), turning))
    return CodePoints(t.ravel(), v_dc.ravel(), w.ravel())


def phase_limit(mesh: CurrentMesh, v_dc: CodeArray) -> FloatArray:
    """Largest phase amplitude in V that the control gives at codes of the dc link."""
    scale = mesh.voltage
    assert scale is not None
    codes = np.minimum(scale.limit.value * np.maximum(v_dc, scale.dc_least), mesh.top)
    return physical(mesh, codes, mesh.bases[1])


@dataclass(frozen=True, slots=True)
class Targets:
    """Points of comparison: codes, the voltage limit there in V, and the exact operating points."""

    codes: CodePoints
    limit: FloatArray
    exact: OptimalPoints


def weakened_targets(design: Design, mesh: CurrentMesh, speed: float) -> Targets:
    """Exact points over torque, voltage and speed up to ``speed`` in rad/s at the design's
    voltage, for all meshes of the same scales and the same end.
    """
    points = weakened_points(design, mesh, speed)
    omega_m = physical(mesh, points.omega_m, mesh.bases[2])
    torque = physical(mesh, points.torque, mesh.bases[3])
    torque = np.clip(torque, -mesh.end_torque, mesh.end_torque)
    volts = phase_limit(mesh, points.v_dc)
    exact = optimal_points(design.machine, torque, omega_m, v_max=volts, i_max=design.i_max)
    return Targets(points, volts, exact)


def weakened_errors(design: Design, mesh: CurrentMesh, targets: Targets) -> MeshErrors:
    """Errors at points of comparison."""
    i_d, i_q = mesh_currents(mesh, targets.codes)
    exact, r_s = targets.exact, design.machine.r_s
    omega_e = design.machine.pole_pairs * exact.omega_m
    psi_d, psi_q = design.machine.flux(i_d, i_q)
    taken = np.hypot(r_s * i_d - omega_e * psi_q, r_s * i_q + omega_e * psi_d)
    excess = float(np.max(taken / targets.limit)) - 1.0
    best = exact.i_d, exact.i_q
    return _errors(design, (i_d, i_q), best, exact.torque, exact.reached, excess)


def _errors(
    design: Design,
    currents: tuple[FloatArray, FloatArray],
    exact: tuple[FloatArray, FloatArray],
    best: FloatArray,
    reached: BoolArray,
    voltage_excess: float | None,
) -> MeshErrors:
    most = float(np.max(np.abs(best)))
    error = float(np.max(np.abs(design.machine.torque(*currents) - best)))
    size, least = np.hypot(*currents), np.hypot(*exact)
    loaded = reached & (np.abs(best) >= _LOADED * most)
    loss = float(np.max((size[loaded] / least[loaded]) ** 2)) - 1.0
    return MeshErrors(
        torque=error,
        torque_relative=error / most,
        current=float(np.max(np.hypot(currents[0] - exact[0], currents[1] - exact[1]))),
        current_excess=float(np.max(size)) / design.i_max - 1.0,
        voltage_excess=voltage_excess,
        loss_relative=loss,
        samples=int(best.size),
    )


# Nodes of a mesh of exact operating points: least currents over torque, and over the flux linkage
# that is left.
#
# Rows crowd where the currents move much with the torque, and columns divide the way of the
# currents evenly, so that all cells are of a size in the plane of the currents: what a bilinear
# cell errs by goes with the square of that size.

# Points on the way of the currents, whose lengths decide where nodes lie.
_FINE_ROWS, _FINE_COLUMNS = 161, 33

# Levels of the flux linkage at which the largest torque is looked up, and steps from there.
_LEVELS = 257
_NODE_HALVINGS = 20
_LEAST_FLUX = 1e-9  # of the largest one
Currents = tuple[FloatArray, FloatArray]


@dataclass(frozen=True, slots=True)
class Nodes:
    """Torques of the rows in N m, shape (K + 1,), and currents in A, shape (K + 1, N + 1)."""

    torque: FloatArray
    i_d: FloatArray
    i_q: FloatArray


def _lengths(currents: Currents) -> FloatArray:
    """Length of the way to each point along the last axis, in A, beginning with 0."""
    steps = np.hypot(*(np.diff(part, axis=-1) for part in currents))
    start = np.zeros((*steps.shape[:-1], 1))
    return np.concatenate([start, np.cumsum(steps, axis=-1)], axis=-1)


def _even(way: FloatArray, at: FloatArray, cells: int) -> FloatArray:
    """Arguments that divide a way evenly, shape (cells + 1,)."""
    if way[-1] <= 0.0:
        return np.linspace(at[0], at[-1], cells + 1)
    # A little of the argument itself keeps nodes apart where the currents rest.
    mixed = way / way[-1] + 1e-3 * (at - at[0]) / (at[-1] - at[0])
    return np.asarray(np.interp(np.linspace(0.0, mixed[-1], cells + 1), mixed, at))


def line_nodes(currents: Callable[[FloatArray], Currents], end: float, rows: int) -> Nodes:
    """Nodes of one column: currents that a torque alone decides.

    Args:
        currents: (i_d, i_q) in A of torques in N m, shape (N,).
        end: Largest torque in N m.
        rows: Cells along the torque.
    """
    # Crowded at the start, where currents may rise like a root.
    fine = end * np.linspace(0.0, 1.0, _FINE_ROWS) ** 3
    torque = _even(_lengths(currents(fine)), fine, rows)
    i_d, i_q = currents(torque)
    return Nodes(torque, i_d[:, np.newaxis], i_q[:, np.newaxis])


def _least_flux_of_nodes(
    region: WeakeningRegion, torque: FloatArray, taken: FloatArray, halvings: int
) -> FloatArray:
    """Least flux linkage in Wb within which torques in N m can be had, shape (N,); not below that
    of the domain, not above ``taken``, that of the least currents.
    """
    levels = np.linspace(region.flux_min, region.flux_max, _LEVELS)
    most = np.maximum.accumulate(region.largest_torque(levels))
    place = np.minimum(np.searchsorted(most, torque), _LEVELS - 1)
    low, high = levels[np.maximum(place - 1, 0)], levels[place]
    for _ in range(halvings):
        middle = 0.5 * (low + high)
        reached = region.largest_torque(middle) >= torque
        low, high = np.where(reached, low, middle), np.where(reached, middle, high)
    return np.minimum(high, taken)


@dataclass(frozen=True, slots=True)
class RowWays:
    """How far the currents of both ends of the rows move along the torque, up to the corner of the
    domain and beyond it: arrays of torques in N m, and of lengths in A.
    """

    torque: tuple[FloatArray, ...]
    length: tuple[FloatArray, ...]


def row_ways(region: WeakeningRegion, end: float) -> RowWays:
    """Ways up to the largest torque at the least flux linkage, where the ends of the rows turn a
    corner, and from there to ``end`` in N m.
    """
    corner = float(region.largest_torque(np.array([region.flux_min]))[0])
    share = np.linspace(0.0, 1.0, _FINE_ROWS)
    parts = [end * share**3]
    if corner < 0.999 * end:
        parts = [corner * share**3, corner + (end - corner) * (0.5 - 0.5 * np.cos(np.pi * share))]
    return RowWays(tuple(parts), tuple(_way(region, torque) for torque in parts))


def _rows(ways: RowWays, rows: int) -> FloatArray:
    """Torques of the rows in N m; one of them is that of the corner."""
    parts = len(ways.length)
    total = sum(float(way[-1]) for way in ways.length)
    first = rows if parts == 1 else round(rows * float(ways.length[0][-1]) / total)
    first = min(max(first, 1), rows - parts + 1)
    pairs = zip(ways.length, ways.torque, [first, rows - first], strict=False)
    nodes = [_even(way, at, cells) for way, at, cells in pairs]
    return np.concatenate([nodes[0], *(part[1:] for part in nodes[1:])])


def _way(region: WeakeningRegion, torque: FloatArray) -> FloatArray:
    least = region.mtpa(torque)
    taken = region.flux(*least)
    levels = _least_flux_of_nodes(region, torque, taken, 3)[:, np.newaxis]
    end = [part[:, 0] for part in _points(region, torque, levels)]
    return np.asarray(_lengths(least) + _lengths((end[0], end[1])))


def mesh_nodes(region: WeakeningRegion, ways: RowWays, shape: tuple[int, int]) -> Nodes:
    """Nodes over torque and flux linkage.

    Args:
        region: Domain of torque and flux linkage.
        ways: Its ways along the torque.
        shape: Cells along the torque, and along the flux linkage.
    """
    rows, columns = shape
    torque = _rows(ways, rows)
    taken = region.flux(*region.mtpa(torque))
    least = _least_flux_of_nodes(region, torque, taken, _NODE_HALVINGS)
    share = np.linspace(0.0, 1.0, _FINE_COLUMNS)
    fine = taken[:, np.newaxis] + (least - taken)[:, np.newaxis] * share
    across = _lengths(_points(region, torque, fine))
    even = np.array([_even(way, share, columns) for way in across])
    flux = taken[:, np.newaxis] + (least - taken)[:, np.newaxis] * even
    return Nodes(torque, *_points(region, torque, flux))


def _points(region: WeakeningRegion, torque: FloatArray, flux: FloatArray) -> Currents:
    """Least currents in A for the torques of rows within flux linkages, shape (K + 1, M)."""
    spread = np.broadcast_to(torque[:, np.newaxis], flux.shape)
    # A flux linkage that the least current just takes must not seem to be too little for it,
    # and without torque a machine without magnets takes none.
    levels = np.maximum(flux * (1.0 + 1e-12), _LEAST_FLUX * region.flux_max)
    found = region.points(spread.ravel(), levels.ravel())
    return found.i_d.reshape(flux.shape), found.i_q.reshape(flux.shape)


# A mesh of exact operating points in integers.

_MOST_SHIFT = 20


def in_integers(design: Design, nodes: Nodes, width: int, dc: tuple[int, int]) -> CurrentMesh:
    """The nodes in words of ``width`` bits.

    Args:
        design: Machine, bases and voltage limit.
        nodes: Torques in N m and currents in A; one column where the voltage limits nothing.
        width: Bits of a code, 16 or 32.
        dc: Scale of the dc link and its least code, as `FixedControl` has them.

    Raises:
        NoSolutionError: Two rows have the same code, or squared voltages have no scale.
    """
    bases = design.control.bases
    one, top = 2 ** (width - 1), 2 ** (width - 1) - 1

    def code(values: FloatArray, base: float) -> FloatArray:
        return np.asarray(np.clip(np.rint(values * (one / base)), -top, top))

    torque = code(nodes.torque, bases.torque)
    if np.any(np.diff(torque) < 1.0):
        raise NoSolutionError(
            f"fixed point: the torque {nodes.torque[-1]:.4g} N m is so small a part of "
            f"control.per_unit.torque, {bases.torque:.4g} N m, that rows of the reference fall on "
            f"one code; write torque: {nodes.torque[-1] * 1.25:.3g} N m"
        )
    i_d, i_q = code(nodes.i_d, bases.current), code(nodes.i_q, bases.current)
    mesh = CurrentMesh(
        width,
        (bases.current, bases.voltage, bases.speed, bases.torque),
        _whole(torque),
        _whole(i_d),
        _whole(i_q),
    )
    if nodes.i_d.shape[1] == 1:
        return mesh
    unit = bases.current / one
    return _with_voltage(design, mesh, (i_d * unit, i_q * unit), dc)


def _whole(values: FloatArray) -> tuple[int, ...]:
    return tuple(int(value) for value in values.ravel())


def _with_voltage(
    design: Design, mesh: CurrentMesh, currents: tuple[FloatArray, FloatArray], dc: tuple[int, int]
) -> CurrentMesh:
    """The mesh with squared voltages, rounded upwards, of the currents that its codes stand for."""
    machine, bases, width = design.machine, design.control.bases, mesh.width
    psi = np.hypot(*machine.flux(*currents))
    size = np.hypot(*currents)
    speed = (machine.pole_pairs * bases.speed / bases.voltage) ** 2
    heat = machine.r_s**2 * size**2 / bases.voltage**2
    drop = 4.0 / 3.0 * machine.r_s * bases.speed * bases.torque / bases.voltage**2
    shift = _shift(float(np.max(psi)) ** 2 * speed, float(np.max(heat)), drop)
    flux = np.ceil(psi**2 * speed * 2.0 ** (width - 1 - shift) * (1.0 - 1e-12))
    square = heat * 2.0 ** (2 * width - 2 - shift)
    low = max(0, math.ceil(math.log2(max(float(np.max(square)), 1.0))) - (width - 2))
    scale = VoltageScale(
        limit=quantise(design.v_max / design.inverter.v_dc * 2.0 ** dc[0], width, 2 ** (width - 1)),
        dc_least=dc[1],
        shift=shift,
        heat=low,
        drop=_drop_gain(drop * 2.0 ** (width - 1 - shift), width),
    )
    found = CurrentMesh(
        width, mesh.bases, mesh.torque, mesh.d, mesh.q,
        _whole(flux), _whole(np.ceil(square / 2.0**low)), _downwards(scale),
    )  # fmt: skip
    mesh_ranges(found)
    return found


def _downwards(scale: VoltageScale) -> VoltageScale:
    """The scale with a voltage limit that is not rounded upwards."""
    limit = scale.limit
    mantissa = math.floor(limit.value * 2.0**limit.shift)
    return VoltageScale(
        FixedGain(mantissa, limit.shift, limit.value),
        scale.dc_least, scale.shift, scale.heat, scale.drop,
    )  # fmt: skip


def _drop_gain(value: float, width: int) -> FixedGain:
    """The gain, 0 where it is too small to count."""
    try:
        return quantise(value, width, 2 ** (width - 1))
    except NoSolutionError:
        if value < 1.0:
            return FixedGain(0, 0, value)
        raise


def _shift(induced: float, heat: float, drop: float) -> int:
    """Least shift of squared voltages with which all parts hold, all per unit."""
    for shift in range(_MOST_SHIFT + 1):
        scale = 2.0**-shift
        if max(2.0 * induced * scale, 4.0 * heat * scale, 2.0 * drop * scale) <= 1.0:
            return shift
    raise NoSolutionError(
        "fixed point: at full speed the machine would take more than a thousand times "
        "control.per_unit.voltage; use a smaller control.per_unit.speed or a larger voltage"
    )


def mesh_ranges(mesh: CurrentMesh) -> tuple[Reach, ...]:
    """Range of every product and sum for any codes, in the order of evaluation.

    Raises:
        NoSolutionError: A quantity can leave its word.
    """
    found = Ranges(mesh.width, "reference: ")
    every = codes(mesh.width)
    mesh.currents(found, every, every, every)
    require(found, "use larger bases in control.per_unit")
    return tuple(found.reaches.values())


# What integer references can at most exceed their limits by, proven for every code.
#
# The integers put the currents between four nodes, within one code of the convex combination that
# they mean. The magnitude of a current is convex, and so is the squared voltage where inductances
# are constant: on a combination both lie at most as high as the combination of what they are at the
# nodes. Those are known exactly, rounded to the safe side, and it is their combination that the
# integers hold to the limit. What is left are the code of the currents, and what the positions
# within a cell are rounded by.

_SLACK = 1e-9  # Share of the limit that stands for what doubles round when nodes are made.


@dataclass(frozen=True, slots=True)
class ProvenExcess:
    """Bounds beyond the limits, relative to them.

    ``current`` holds for all codes. ``voltage`` is that of the phase voltage, resistance drop
    included, from `LEAST_VOLTAGE` of the design's up and for speeds up to the largest in proportion
    to the voltage; None where the voltage limits nothing, and for flux maps, whose squared voltage
    need not be convex.
    """

    current: float
    voltage: float | None


def proven_excess(design: Design, mesh: CurrentMesh, speed: float | None) -> ProvenExcess:
    """Bounds for a mesh.

    Args:
        design: Machine and limits.
        mesh: The integers.
        speed: Largest mechanical speed in rad/s at the design's voltage, None where that limits
            nothing.
    """
    unit = mesh.bases[0] / 2.0 ** (mesh.width - 1)
    currents = _nodes(mesh, mesh.d) * unit, _nodes(mesh, mesh.q) * unit
    away = math.sqrt(2.0) * unit
    most = float(np.max(np.hypot(*currents))) + away
    voltage = None
    if speed is not None and isinstance(design.machine, LinearMachine):
        voltage = _voltage(design, design.machine, mesh, currents, speed)
    return ProvenExcess(most / design.i_max - 1.0 + _SLACK, voltage)


def _nodes(mesh: CurrentMesh, values: tuple[int, ...]) -> FloatArray:
    return np.array(values, dtype=np.float64).reshape(-1, mesh.columns)


def _voltage(
    design: Design,
    machine: LinearMachine,
    mesh: CurrentMesh,
    currents: tuple[FloatArray, FloatArray],
    speed: float,
) -> float | None:
    """Bound of |v|/V - 1; None where even without torque the voltage cannot be kept."""
    assert mesh.voltage is not None
    volts = LEAST_VOLTAGE * design.v_max
    omega = machine.pole_pairs * speed * LEAST_VOLTAGE  # at that voltage
    psi = np.hypot(*machine.flux(*currents))
    size = np.hypot(*currents)
    if (omega * psi[0, -1]) ** 2 + (machine.r_s * size[0, -1]) ** 2 > volts**2 * (1.0 - _SLACK):
        return None
    part = 2.0**-mesh.fraction
    rows = np.array(mesh.torque) * (mesh.bases[3] / 2.0 ** (mesh.width - 1))
    missed = float(np.max(np.abs(machine.torque(*currents) - rows[:, np.newaxis])))
    drop = mesh.voltage.drop
    rounded = abs(drop.error) if drop.mantissa else 1.0
    torque = missed + (rounded + part) * float(rows[-1])
    # All over the squared voltage, where the speed goes with the voltage: largest at the least one.
    share = 2.0 * machine.r_s * omega * torque / (1.5 * machine.pole_pairs) / volts**2
    share += part * (omega / volts) ** 2 * float(np.max(psi[:, :-1] ** 2 - psi[:, 1:] ** 2))
    unit = mesh.bases[0] / 2.0 ** (mesh.width - 1)
    inductance = max(abs(machine.l_d), abs(machine.l_q))
    moved = math.sqrt(2.0) * unit * (machine.r_s + omega * inductance) / volts
    return float(math.sqrt(1.0 + share) - 1.0 + moved + _SLACK)


# The integer references that a design asks for.


@on_design("export.control")
def solve_fixed_references(
    design: Design, fit: ReferenceFit, weakening: WeakeningFit | None
) -> tuple[FixedReferenceFit, ...]:
    """Integer references for the fixed-point formats of the control functions; none where each
    sign of the torque has a reference of its own (the halves of a flux map).

    Args:
        design: The design.
        fit: Its current reference over torque: strategy, speed and end of the domain.
        weakening: Its reference over torque, voltage and speed, None where it asks for none.

    Raises:
        NoSolutionError: As `fit_line` and `fit_mesh`.
    """
    if design.halves is not None:
        return ()
    widths = [FIXED_WIDTHS[name] for name in design.export.control if name in FIXED_WIDTHS]
    return tuple(_solve(design, fit, weakening, width) for width in widths)


def _solve(
    design: Design, fit: ReferenceFit, weakening: WeakeningFit | None, width: int
) -> FixedReferenceFit:
    if weakening is not None:
        from dqforge.optimizer.fixed_control.design import dc_link

        return fit_mesh(design, weakening.domain, fit.torque_max, width, dc_link(design, width))
    permitted = fit.errors.torque_relative
    from dqforge.optimizer.operating_points.solve import current_choice

    return fit_line(design, current_choice(design), fit.torque_max, permitted, width)
