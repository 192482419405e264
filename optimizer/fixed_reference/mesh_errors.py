"""Errors of integer references against exact operating points, in amperes, torque and voltage."""

from __future__ import annotations

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.design import Design
from dqforge.machines.records import dataclass
from dqforge.optimizer.field_weakening.voltage_region import LEAST_VOLTAGE
from dqforge.optimizer.fixed_control.arithmetic import BoolArray, CodeArray, Integers
from dqforge.optimizer.fixed_reference.mesh import CurrentMesh
from dqforge.optimizer.operating_points.current_choice import CurrentChoice
from dqforge.optimizer.operating_points.points import OptimalPoints, optimal_points

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
