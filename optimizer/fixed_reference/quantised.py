"""A mesh of exact operating points in integers."""

from __future__ import annotations

import math

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.design import Design
from dqforge.machines.errors import NoSolutionError
from dqforge.optimizer.fixed_control.arithmetic import Ranges, Reach
from dqforge.optimizer.fixed_control.ranges import codes, require
from dqforge.optimizer.fixed_reference.mesh import CurrentMesh, VoltageScale
from dqforge.optimizer.fixed_reference.nodes import Nodes
from dqforge.optimizer.loops.integer_gains import FixedGain, quantise

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
