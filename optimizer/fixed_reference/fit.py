"""The smallest integer reference that keeps its errors, and its evidence."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from dqforge.machines.design.design import Design
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.machines.records import dataclass
from dqforge.optimizer.field_weakening.exact import WeakeningRegion
from dqforge.optimizer.field_weakening.voltage_region import LEAST_VOLTAGE, VoltageRegion
from dqforge.optimizer.fixed_control.arithmetic import Reach
from dqforge.optimizer.fixed_reference.mesh import CurrentMesh
from dqforge.optimizer.fixed_reference.mesh_errors import (
    MeshErrors,
    line_errors,
    weakened_errors,
    weakened_targets,
)
from dqforge.optimizer.fixed_reference.nodes import Nodes, line_nodes, mesh_nodes, row_ways
from dqforge.optimizer.fixed_reference.proven_excess import ProvenExcess, proven_excess
from dqforge.optimizer.fixed_reference.quantised import in_integers, mesh_ranges
from dqforge.optimizer.operating_points.current_choice import CurrentChoice

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
