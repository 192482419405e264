"""What stays the same whatever machine it meets: the current reference and the gains of a header,
as they are emitted.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.design import Design
from dqforge.machines.devices.inverter import Inverter
from dqforge.machines.dq_machines.flux_map import ScaledMachines
from dqforge.machines.dq_machines.machine_batch import MachineBatch
from dqforge.machines.errors import InputError
from dqforge.machines.names import ModulationName
from dqforge.machines.records import dataclass
from dqforge.optimizer.control_design.gain_set import solve_gains
from dqforge.optimizer.current_reference.fit import signed_designs, signed_reference
from dqforge.optimizer.current_reference.forms import Emitted, FixedReference
from dqforge.optimizer.current_reference.solve import solve_fit
from dqforge.optimizer.exploration.batch_currents import strategy_currents
from dqforge.optimizer.exploration.sensitivities import currents_on_loci, scaled_loci
from dqforge.optimizer.loops.loop_axes import given_current_loops
from dqforge.optimizer.loops.loop_gains import LoopGains
from dqforge.optimizer.losses.drive_budget import BudgetOptions, DriveBudget, drive_budget


@dataclass(frozen=True, slots=True)
class FixedLoop:
    """Gains of a current loop as the header holds them, rounded to single precision.

    Args:
        kp: Proportional gain in V/A.
        ki_ts: Integral gain per sample in V/A.
        t_s: Sampling period in s.
    """

    kp: float
    ki_ts: float
    t_s: float

    @classmethod
    def emitted(cls, kp: float, ki_ts: float, t_s: float) -> FixedLoop:
        """A loop with gains in double, as the header spells them out."""
        return cls(float(np.float32(kp)), float(np.float32(ki_ts)), t_s)

    @property
    def ki(self) -> float:
        """Integral gain in V/(A s)."""
        return self.ki_ts / self.t_s


@dataclass(frozen=True, slots=True)
class FixedHeader:
    """A header that is flashed to every drive.

    Args:
        reference: The current reference in the arithmetic of the emitted C.
        i_d, i_q: The current loops, None where the header has none in rotor coordinates.
        v_dc: DC-link voltage in V that the loops were designed for.
        speed: Mechanical speed in rad/s at which the reference keeps the voltage limit, None where
            it knows none: it then is to have the least copper loss.
        digest: SHA-256 of the design that the header was made of, in hexadecimal.
    """

    reference: Emitted
    i_d: FixedLoop | None
    i_q: FixedLoop | None
    v_dc: float
    speed: float | None = None
    digest: str = ""

    @property
    def torque_max(self) -> float:
        """End of the domain in N m, the full scale of its torque."""
        return float(self.reference.torque_max)


def nominal_header(design: Design) -> FixedHeader:
    """The header that a design gives, rounded as it is emitted.

    Args:
        design: The design.

    Raises:
        InputError: It is a six-step drive, which has no currents in rotor coordinates.
        NoSolutionError: There is no fit, or no gains.
    """
    if design.control.six_step is not None:
        raise InputError(
            "header: a six-step drive has no reference over the torque; leave header out, or write "
            "another control.observer"
        )
    positive, negative = signed_designs(design)
    fit = solve_fit(positive).fit
    reference: Emitted = fit.reference
    if negative is not None:
        reference = signed_reference(fit, solve_fit(negative).fit)
    loops = None if design.control.current_loop.switches else solve_gains(design)
    return FixedHeader(
        reference=reference,
        i_d=None if loops is None else _fixed(loops.i_d),
        i_q=None if loops is None else _fixed(loops.i_q),
        v_dc=design.inverter.v_dc,
        speed=None if fit.speed is None else fit.speed.omega_m,
        digest=design.digest,
    )


def _fixed(gains: LoopGains) -> FixedLoop:
    return FixedLoop.emitted(gains.kp, gains.ki_ts, gains.t_s)


# Outputs of a study with a fixed header, for many machines at once, by their names.
#
# Losses are those of `header_budget`, by the names that a study has for a budget anyway.

# Largest torque error over the full scale of the header, a share.
TORQUE_ERROR = "reference.torque_error"

# Largest excess of the copper loss over the least one of the machine, a share of that.
LOSS_PENALTY = "reference.loss_penalty"

# Torque in N m that the machine makes where the full scale of the header is asked for.
TORQUE_MADE = "reference.torque_made"

# Torque in N m at which the header clamps what is asked for, the same on every machine.
TORQUE_MAX = "reference.torque_max"
LEAST_MARGIN = "gains.phase_margin"  # Least phase margin in rad over the current loops.


def output_names(header: FixedHeader) -> tuple[str, ...]:
    """Outputs of reference and gains that a header has.

    Args:
        header: The header.
    """
    loops = [loop for loop in LOOPS if getattr(header, loop) is not None]
    penalty = () if header.speed is not None else (LOSS_PENALTY,)
    gains = [f"gains.{loop}.{margin}" for loop in loops for margin in MARGINS]
    return (
        TORQUE_MAX,
        TORQUE_ERROR,
        TORQUE_MADE,
        *penalty,
        *gains,
        *((LEAST_MARGIN,) if loops else ()),
    )


def yield_outputs(
    header: FixedHeader,
    machines: Machines,
    wanted: Collection[str],
    v_dc: FloatArray | float | None = None,
) -> dict[str, FloatArray]:
    """Outputs of N machines under one header, by name in the order of ``wanted``, arrays of shape
    (N,); NaN for what does not exist.

    Args:
        header: What is flashed to every drive.
        machines: N machines.
        wanted: Names of outputs, as `output_names` has them; what none of them needs is not
            computed.
        v_dc: DC-link voltage in V of each drive, one number or shape (N,); that of the header when
            None.

    Raises:
        InputError: A name is none of those that a fixed header has.
    """
    check_outputs(header, wanted)
    voltage = header.v_dc if v_dc is None else v_dc
    found = _reference(header, machines, wanted) | _gains(header, machines, wanted, voltage)
    return {name: found[name] for name in wanted}


def check_outputs(header: FixedHeader, wanted: Collection[str]) -> None:
    """Refuse outputs of reference and gains that a fixed header does not have.

    Args:
        header: The header.
        wanted: Names of outputs.

    Raises:
        InputError: Names the first of them, and what to write instead.
    """
    known = output_names(header)
    for name in wanted:
        if name in known:
            continue
        if name.startswith("gains."):
            fixed_loop(header, name.split(".")[1])
        if name == LOSS_PENALTY:
            raise InputError(
                f"{name}: the header keeps the voltage limit at {header.speed:.4g} rad/s, its "
                "currents are not meant to be the least; omit the output"
            )
        raise InputError(
            f"{name}: is not known of a fixed header; write {TORQUE_ERROR}, or leave header out"
        )


def _reference(
    header: FixedHeader, machines: Machines, wanted: Collection[str]
) -> dict[str, FloatArray]:
    found = {TORQUE_MAX: np.full(machines.count, header.torque_max)}
    if not {TORQUE_ERROR, TORQUE_MADE, LOSS_PENALTY}.intersection(wanted):
        return found
    points = reference_points(header)
    produced = produced_torque(points, machines)
    if TORQUE_ERROR in wanted:
        found[TORQUE_ERROR] = torque_errors(header, points, produced)
    if TORQUE_MADE in wanted:
        found[TORQUE_MADE] = produced[-1]
    if LOSS_PENALTY in wanted:
        found[LOSS_PENALTY] = loss_penalties(points, machines, produced)
    return found


def _gains(
    header: FixedHeader,
    machines: Machines,
    wanted: Collection[str],
    v_dc: FloatArray | float,
) -> dict[str, FloatArray]:
    asked = {name.split(".")[1] for name in wanted if name.startswith("gains.")}
    least = LEAST_MARGIN in wanted
    wanted_loops = [loop for loop in LOOPS if loop in asked or least]
    if not wanted_loops:
        return {}
    points, ratio = reference_points(header), v_dc / header.v_dc
    single = {
        loop: loop_outputs(
            fixed_loop(header, loop), machines.r_s, axis_inductance(loop, machines, points), ratio
        )
        for loop in wanted_loops
    }
    found = {
        f"gains.{loop}.{name}": values
        for loop, margins in single.items()
        for name, values in margins.items()
    }
    return found | ({LEAST_MARGIN: least_phase_margin(single)} if least else {})


# A fixed current reference on other machines than it was made for: how far the torque is off,
# and how much copper loss a reference of the machine's own would save.
#
# The currents of the header flow in every machine. At a torque T* that is asked for,
#
#     T = 3/2 p (psi_d(i_d, i_q) i_q - psi_q(i_d, i_q) i_d)
#
# is made, with the flux linkage of the machine, be it constant inductances or a scaled flux map.
# The error is |T - T*| over the full scale, the penalty |i|^2 / least |i|^2 - 1, where the least is
# that of the same machine for the torque T that it makes.

TORQUES = 20  # Torques at which a header is judged, evenly spaced up to its full scale.
LEAST_SHARE = 0.05  # Share of the full scale at which they begin: below it both losses vanish.

# Many machines: with constant inductances, or over one flux map.
Machines = MachineBatch | ScaledMachines

# Largest current of a header by which loci go on: so far that rounding leaves no torque out.
_BEYOND = 1.001


@dataclass(frozen=True, slots=True)
class ReferencePoints:
    """What a header asks for at P torques, arrays of shape (P,): torque in N m, currents in A."""

    torque: FloatArray
    i_d: FloatArray
    i_q: FloatArray


def reference_points(header: FixedHeader, torque: FloatArray | None = None) -> ReferencePoints:
    """Currents of the header as its C returns them, without contraction.

    Args:
        header: The header.
        torque: Torques in N m, shape (P,); when None those at which a header is judged. Each is
            rounded to a number that the header's format has.
    """
    asked = np.linspace(LEAST_SHARE, 1.0, TORQUES) * header.torque_max if torque is None else torque
    reference = header.reference
    if isinstance(reference, FixedReference):
        has = reference.scale.arguments(np.minimum(reference.nearest(asked), reference.end))
    else:
        has = np.asarray(asked, dtype=np.float32).astype(np.float64)
    i_d, i_q = reference.currents(has)
    return ReferencePoints(has, i_d.astype(np.float64), i_q.astype(np.float64))


def produced_torque(points: ReferencePoints, machines: Machines) -> FloatArray:
    """Torque in N m that the header's currents make, shape (P, N).

    Args:
        points: Currents of the header at P torques.
        machines: N machines.
    """
    return machines.torque(points.i_d[:, np.newaxis], points.i_q[:, np.newaxis])


def torque_errors(header: FixedHeader, points: ReferencePoints, produced: FloatArray) -> FloatArray:
    """Largest torque error of each machine over the full scale, shape (N,).

    Args:
        header: The header.
        points: Currents of the header at P torques.
        produced: Torque in N m that they make, shape (P, N).
    """
    off = np.abs(produced - points.torque[:, np.newaxis])
    return np.asarray(np.max(off, axis=0) / header.torque_max)


def loss_penalties(points: ReferencePoints, machines: Machines, produced: FloatArray) -> FloatArray:
    """Largest excess of the copper loss over the least one, relative to it, of each machine,
    shape (N,); infinite where a torque is not made at all, NaN where a machine's optimum leaves the
    data of its flux map.

    Args:
        points: Currents of the header at P torques.
        machines: N machines.
        produced: Torque in N m that the currents make, shape (P, N).
    """
    square = (points.i_d**2 + points.i_q**2)[:, np.newaxis]
    own_d, own_q = _own_currents(points, machines, np.maximum(produced, 0.0))
    least = own_d * own_d + own_q * own_q
    made = least > 0.0  # neither without torque nor on a machine that makes none
    penalty = np.where(made, square / np.where(made, least, 1.0) - 1.0, np.inf)
    if isinstance(machines, ScaledMachines):
        penalty = np.where(np.isnan(least) & (produced > 0.0), np.nan, penalty)
    return np.asarray(np.max(penalty, axis=0))


def _own_currents(
    points: ReferencePoints, machines: Machines, torque: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Currents in A of each machine's own optimum for torques >= 0 in N m, shape (P, N).

    The optimum for a torque that the header's current makes needs no more than that current.
    """
    if isinstance(machines, MachineBatch):
        return strategy_currents(machines, "mtpa", torque)
    largest = _BEYOND * float(np.max(np.hypot(points.i_d, points.i_q)))
    within = replace(machines, i_max=np.full(machines.count, largest))
    return currents_on_loci(within, scaled_loci(within), torque)


# Fixed gains of the current loops on other machines than they were made for.
#
# The loop sees the machine's resistance and inductance. Firmware that does not measure its DC link
# divides by the voltage it was told of, so that a voltage that is higher by a factor raises the
# gain of both loops by that factor.

LOOPS = ("i_d", "i_q")  # Loops of a header whose gains are judged on every machine.

# What is known of each of them: rad, a factor, s, rad/s, a factor, and 1 or 0.
MARGINS = (
    "phase_margin",
    "gain_margin",
    "delay_margin",
    "crossover",
    "max_sensitivity",
    "stable",
)


def fixed_loop(header: FixedHeader, loop: str) -> FixedLoop:
    """Gains of a loop of the header.

    Args:
        header: The header.
        loop: ``i_d`` or ``i_q``.

    Raises:
        InputError: The header has no such loop.
    """
    found: FixedLoop | None = getattr(header, loop) if loop in LOOPS else None
    if found is None:
        raise InputError(
            f"gains.{loop}: a header's gains are evaluated on drawn machines for the current loops "
            "i_d and i_q; write gains.i_d.phase_margin or gains.i_q.phase_margin"
            if loop not in LOOPS
            else f"gains.{loop}: the header has no loops in rotor coordinates; omit gains"
        )
    return found


def axis_inductance(loop: str, machines: Machines, points: ReferencePoints) -> FloatArray:
    """Inductance in H that a loop sees in every machine, shape (N,): of flux maps the least
    incremental one at rest and at the header's currents, where the loop is fastest.

    Args:
        loop: ``i_d`` or ``i_q``.
        machines: N machines.
        points: Currents of the header.
    """
    if isinstance(machines, MachineBatch):
        return machines.l_d if loop == "i_d" else machines.l_q
    i_d, i_q = (np.append(0.0, values)[:, np.newaxis] for values in (points.i_d, points.i_q))
    jet = machines.jet(i_d + np.zeros(machines.count), i_q + np.zeros(machines.count))
    return np.asarray(np.min(jet.l_dd if loop == "i_d" else jet.l_qq, axis=0))


def loop_outputs(
    fixed: FixedLoop,
    r_s: FloatArray,
    inductance: FloatArray,
    voltage_ratio: FloatArray | float,
) -> dict[str, FloatArray]:
    """Margins of one loop on every machine, by their names in `MARGINS`, arrays of shape (N,);
    NaN where the loop is not stable.

    Args:
        fixed: Gains of the loop.
        r_s: Phase resistance in Ohm of every machine, shape (N,).
        inductance: Inductance in H that the loop sees, shape (N,).
        voltage_ratio: DC-link voltage that they have over the one the loops were designed for, one
            number or shape (N,).
    """
    margins = given_current_loops(
        r_s, inductance, fixed.t_s, fixed.kp, fixed.ki, voltage_ratio
    ).margins
    found = {name: getattr(margins, name) for name in MARGINS if name != "stable"}
    return {name: np.where(margins.stable, found[name], np.nan) for name in found} | {
        "stable": margins.stable.astype(np.float64)
    }


def least_phase_margin(found: dict[str, dict[str, FloatArray]]) -> FloatArray:
    """Least phase margin in rad over the loops, shape (N,); NaN where one is not stable.

    Args:
        found: What `loop_outputs` gives, by loop.
    """
    return np.asarray(np.min([loop["phase_margin"] for loop in found.values()], axis=0))


# Losses of a fixed header on other machines than it was made for.
#
# At a point the firmware is asked for a torque, and the currents of the header flow, in every
# machine the same ones: what differs is what these currents cost there. A machine whose torque
# falls short thereby looks no better than it is, since its torque error says so beside it. The DC
# link has the voltage of the inverter given, whatever is drawn for the gain of the loops: losses
# are stated at points of operation, of which the voltage is one.


@dataclass(frozen=True, slots=True)
class FixedDrive:
    """What is round every machine: the header that all are flashed with, the inverter that feeds
    them, and what is counted beside copper, conduction and switching.
    """

    header: FixedHeader
    inverter: Inverter
    options: BudgetOptions


def point_currents(header: FixedHeader, torque: FloatArray) -> ReferencePoints:
    """Currents of the header at points of operation.

    Args:
        header: The header.
        torque: Torques in N m that are asked for, shape (P,).

    Raises:
        InputError: A point lies beyond the end of the header.
    """
    for place, asked in enumerate(torque.tolist()):
        if abs(asked) > header.torque_max * (1.0 + 1e-6):
            raise InputError(
                f"losses.points.{place}: {asked:g} N m is beyond the {header.torque_max:g} N m at "
                "which the header clamps the torque; write a smaller torque"
            )
    return reference_points(header, torque)


def header_budget(
    drive: FixedDrive,
    machines: Machines,
    torque: FloatArray,
    omega_m: FloatArray,
    modulations: Sequence[ModulationName],
) -> DriveBudget:
    """Budget of N machines at P points with M modulators, arrays (M, 1, N P): the points of the
    first machine, then those of the second.

    Args:
        drive: Header and inverter.
        machines: N machines.
        torque, omega_m: Torques in N m that are asked for, and mechanical speeds in rad/s, shape
            (P,).
        modulations: M modulators.

    Raises:
        InputError: As `point_currents`.
    """
    points = point_currents(drive.header, torque)
    count = machines.count
    return drive_budget(
        machines.repeated(torque.size),
        drive.inverter,
        np.tile(points.i_d, count),
        np.tile(points.i_q, count),
        np.tile(omega_m, count),
        modulations,
        options=drive.options,
    )
