"""One design, solved: the current reference, the gains and the loss comparison, each with its evidence."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from dqforge.machines.design import Design
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.machines.numerical import on_design
from dqforge.machines.salient_phase_machine import SalientPhaseMachine
from dqforge.machines.synchronous import LinearMachine, Machine, linearised
from dqforge.optimizer.certificate import Certificate, certify
from dqforge.optimizer.characteristics import voltage_limit
from dqforge.optimizer.choice_solution import ModulationChoice, solve_choice
from dqforge.optimizer.current_choice import CurrentChoice, OperatingPoints, SpeedPoint
from dqforge.optimizer.current_reference import Emitted, SignedReference
from dqforge.optimizer.data_use import COVERED, DataUse, data_use
from dqforge.optimizer.drive_budget import BudgetOptions
from dqforge.optimizer.drive_comparison import Alternatives
from dqforge.optimizer.fit_alternatives import Alternative, alternatives
from dqforge.optimizer.fit_choice import FitChoice, Trial, choose_fit
from dqforge.optimizer.fixed_design import FixedControlFit, fit_controls
from dqforge.optimizer.fixed_reference import FixedReference
from dqforge.optimizer.gain_schedule import GainSchedule, schedule_gains
from dqforge.optimizer.gains import LoopGains, tune_current_loop, tune_speed_loop
from dqforge.optimizer.loop_batch import PlantBatch
from dqforge.optimizer.mission_budget import MissionComparison, compare_mission
from dqforge.optimizer.mtpa import PerUnitBase, per_unit_base
from dqforge.optimizer.mtpa_locus import mtpa_locus
from dqforge.optimizer.observed_loop import judge_observed
from dqforge.optimizer.observer import ReducedOrderObserver, reduced_order_observer
from dqforge.optimizer.observer_conditions import conditions
from dqforge.optimizer.observer_tuning import PositionObserver, tune_position_observer
from dqforge.optimizer.phase_reference import PhaseFit, fit_phases
from dqforge.optimizer.point_losses import LossComparison, compare_points
from dqforge.optimizer.reference_fit import ReferenceFit, domain_end, fit_reference
from dqforge.optimizer.robustness import RobustSet, current_robustness, speed_robustness, turning_robustness
from dqforge.optimizer.salient_reference import fit_salient_phases
from dqforge.optimizer.surface_fit import WeakeningFit, fit_weakening
from dqforge.optimizer.tolerance_box import Axis, drive_box
from dqforge.optimizer.waveform_comparison import WaveformComparison, compare_waveforms, limits_of, require_phases

_CURVE_POINTS = 201


@dataclass(frozen=True, slots=True)
class Curves:
    """Operating points from zero to the end of the torque domain, for the design's strategy and for i_d = 0.

    ``id0`` is None for a machine without magnet and at a speed; ``base`` is None where the MTPA curve has no scale of
    its own.
    """

    chosen: OperatingPoints
    id0: OperatingPoints | None
    base: PerUnitBase | None


@dataclass(frozen=True, slots=True)
class GainSet:
    """Gains of both current loops and, where the design asks for them, of the speed loop and an observer.

    ``observer`` is the reduced-order speed observer, ``position`` one of the position; a design has at most one.
    ``robust`` is what they keep over the tolerances (the speed loop only without an observer), None where the design
    names none; ``schedule`` the current loops'
    gains over the current, None where it asks for none.
    """

    i_d: LoopGains
    i_q: LoopGains
    speed: LoopGains | None
    observer: ReducedOrderObserver | None
    robust: RobustSet | None = None
    schedule: GainSchedule | None = None
    position: PositionObserver | None = None


@dataclass(frozen=True, slots=True)
class NegativeHalf:
    """The reference of negative torques where the halves of a machine are kept, as that of the mirrored machine."""

    design: Design
    curves: Curves
    fit: ReferenceFit
    certificate: Certificate | None


@dataclass(frozen=True, slots=True)
class Solution:
    """Everything that a design asks for.

    ``losses`` is None where it asks for no comparison; ``waveforms`` and ``phases`` are None for machines with a
    sinusoidal back-EMF. ``certificate`` bounds the errors of the fit, None where that could not be proven;
    ``trials`` are the forms that were tried for a budget. ``weakening`` is None where no
    two-dimensional reference, ``choice`` where no choice of modulator and switching frequency, ``mission`` where
    no mission is asked for. ``fixed`` are control functions in fixed point. ``data`` says where the reference is held
    by the data of a flux map, or leaves them. ``loops`` is None where none are wanted, or
    where a design without a section ``control`` has none that hold; ``gains_left_out`` then says why. ``negative`` is
    None where one reference serves torques of both signs; else ``fit`` and ``certificate`` are those of positive ones.
    """

    design: Design
    curves: Curves
    fit: ReferenceFit
    alternatives: tuple[Alternative, ...]
    loops: GainSet | None
    losses: LossComparison | None
    waveforms: WaveformComparison | None = None
    phases: PhaseFit | None = None
    trials: tuple[Trial, ...] = ()
    certificate: Certificate | None = None
    weakening: WeakeningFit | None = None
    choice: ModulationChoice | None = None
    mission: MissionComparison | None = None
    fixed: tuple[FixedControlFit, ...] = ()
    data: DataUse = COVERED
    gains_left_out: str = ""
    negative: NegativeHalf | None = None

    @property
    def reference(self) -> Emitted:
        """What the firmware evaluates for torques of both signs."""
        if self.negative is None:
            return self.fit.reference
        return signed_reference(self.fit, self.negative.fit)

    @property
    def gains(self) -> GainSet:
        """The gains, for what needs them.

        Raises
        ------
        InputError
            There are none.
        """
        if self.loops is None:
            raise InputError(f"this needs gains, and there are none: {self.gains_left_out}")
        return self.loops


def current_choice(design: Design) -> CurrentChoice:
    """What the design's currents are chosen by."""
    operation = design.operation
    if operation.omega_m is None:
        return CurrentChoice(design.machine, operation.strategy, design.i_max)
    limit = voltage_limit(design.inverter, operation.modulation, operation.voltage_margin)
    point = SpeedPoint(operation.omega_m, limit.v_max)
    return CurrentChoice(design.machine, operation.strategy, design.i_max, point)


def signed_reference(positive: ReferenceFit, negative: ReferenceFit) -> SignedReference:
    """The references of both signs of the torque as one.

    Raises
    ------
    InputError
        One of them is in fixed point.
    """
    if isinstance(positive.reference, FixedReference) or isinstance(negative.reference, FixedReference):
        raise InputError("machine.flux_map.symmetry: keep needs references in float32; write fit: format: float32")
    return SignedReference(positive.reference, negative.reference)


def signed_designs(design: Design) -> tuple[Design, Design | None]:
    """The design as positive torques see it, and its mirror image as negative ones do; None where that is the same."""
    if design.halves is None:
        return design, None
    positive, negative = (replace(design, machine=half) for half in design.halves)
    return positive, negative


def solve_negative(design: Design) -> NegativeHalf | None:
    """Reference of negative torques of a design that keeps the halves of its machine apart; else None."""
    mirrored = signed_designs(design)[1]
    if mirrored is None:
        return None
    found = solve_fit(mirrored).fit
    proof = certify(current_choice(mirrored), found.reference, found.errors)
    return NegativeHalf(mirrored, solve_curves(mirrored), found, proof)


@on_design("operation")
def solve_curves(design: Design, torque_max: float | None = None) -> Curves:
    """Operating points on an even grid of torques up to ``torque_max`` N m, or to the end of the fit's domain."""
    choice, machine = current_choice(design), design.machine
    end = torque_max if torque_max is not None else domain_end(choice, design.fit)
    torque = np.linspace(0.0, end, _CURVE_POINTS)
    compared = machine.psi_pm > 0.0 and choice.speed is None  # at a speed i_d = 0 may not keep the voltage limit
    id0 = CurrentChoice(machine, "id0", design.i_max).points(torque) if compared else None
    linear = choice.closed_form
    has_base = linear is not None and linear.psi_pm > 0.0 and linear.saliency != 0.0
    return Curves(choice.points(torque), id0, per_unit_base(linear) if linear is not None and has_base else None)


@on_design("fit")
def solve_fit(design: Design) -> FitChoice:
    """Current reference of the design: as set, or the cheapest that keeps its budget."""
    choice, budget = current_choice(design), design.fit.budget
    if budget is None:
        found = FitChoice(fit_reference(choice, design.fit), ())
    else:
        found = choose_fit(choice, design.fit, budget)
    return replace(found, data=data_use(choice, found.fit.torque_max))


def tuning_inductances(machine: Machine, i_max: float) -> tuple[float, float]:
    """Inductances (l_d, l_q) in H that current loops are tuned for.

    Those of a saturated machine are the least incremental ones along its MTPA locus up to ``i_max`` A: a loop is
    fastest there, so that it is slower and has more margin everywhere else.
    """
    return inductance_range(machine, i_max)[0]


def inductance_range(machine: Machine, i_max: float) -> tuple[tuple[float, float], tuple[float, float]]:
    """Least and largest incremental inductances (l_d, l_q) in H along the MTPA locus up to ``i_max`` A."""
    if isinstance(machine, LinearMachine):
        return (machine.l_d, machine.l_q), (machine.l_d, machine.l_q)
    locus = mtpa_locus(machine, i_max)
    jet = machine.jet(locus.i_d, locus.i_q)
    least, largest = ((float(of(jet.l_dd)), float(of(jet.l_qq))) for of in (np.min, np.max))
    return least, largest


def _solve_observer(design: Design) -> tuple[ReducedOrderObserver | None, PositionObserver | None]:
    """The observer of the speed, or that of the position, which the design asks for."""
    machine, control = design.machine, design.control
    wanted = control.observer
    if wanted is None:
        return None, None
    if wanted.method == "reduced-order" and wanted.pole is not None:
        return reduced_order_observer(machine, wanted.pole, control.t_s), None
    omega_m = machine.omega_m_max if machine.omega_m_max is not None else control.bases.speed
    omega_max = omega_m * machine.pole_pairs
    known = conditions(design, omega_max)
    return None, tune_position_observer(
        linearised(machine), wanted, control.t_s, design.inverter.v_dc, omega_max, known
    )


@on_design("control")
def solve_gains(design: Design) -> GainSet:
    """Gains of the design, every loop checked as it is sampled, and over the tolerances where it names any."""
    machine, control = design.machine, design.control
    nominal, largest = inductance_range(machine, design.i_max)
    box = drive_box(design, nominal, largest)
    named = control.tolerances is not None

    def axis_corners(axis: Axis) -> PlantBatch | None:
        if control.current_loop.method != "optimised":
            return None
        points = box.current_points(axis)
        return box.current_loop_plants(axis, points).some(np.arange(points.corners))

    def speed_corners() -> PlantBatch | None:
        if control.speed_loop is None or control.speed_loop.method != "optimised":
            return None
        points = box.speed_points()
        return box.speed_loop_plants(points, (i_q.kp, i_q.ki)).some(np.arange(points.corners))

    l_d, l_q = nominal
    i_d = tune_current_loop(machine.r_s, l_d, control.t_s, control.current_loop, "i_d", axis_corners("i_d"))
    i_q = tune_current_loop(machine.r_s, l_q, control.t_s, control.current_loop, "i_q", axis_corners("i_q"))
    speed = tune_speed_loop(machine, i_q, control, speed_corners()) if control.speed_loop is not None else None
    observer, position = _solve_observer(design)
    robust = None
    if named:
        robust = RobustSet(
            current_robustness(box, i_d, "i_d"),
            current_robustness(box, i_q, "i_q"),
            None if speed is None else speed_robustness(box, speed, i_q),
            turning_robustness(box, i_d, i_q),
            box.named_limits(),
        )
    wanted = control.current_loop.schedule
    schedule = schedule_gains(design, box if named else None, i_d, i_q) if wanted else None
    if speed is not None and (observer is not None or position is not None):
        speed = judge_observed(design, (i_d, i_q, speed), observer, position)
        robust = None if robust is None else replace(robust, speed=None)
    return GainSet(i_d, i_q, speed, observer, robust, schedule, position)


@on_design("losses")
def solve_losses(design: Design) -> LossComparison | None:
    """Loss comparison of the design, or None where it asks for none.

    What a strategy cannot make within the limits is marked in the comparison, and so are junctions that run away.
    """
    losses = design.losses
    if losses is None or not losses.points:
        return None
    return compare_points(
        design.machine,
        design.inverter,
        losses,
        i_max=design.i_max,
        options=BudgetOptions(design.machine_loss, design.winding, design.inverter.capacitor_esr),
        margin=design.operation.voltage_margin,
    )


@on_design("losses")
def require_losses(design: Design) -> LossComparison:
    """Loss comparison of the design; raises `InputError` where it asks for none."""
    found = solve_losses(design)
    if found is None:
        raise InputError(
            "the design asks for no comparison; add a section 'losses' with 'points', or ask with --map or --mission"
        )
    return found


@on_design("losses.mission")
def solve_mission(design: Design) -> MissionComparison | None:
    """Energies over the mission of the design, None where it names none.

    Raises
    ------
    InputError, NoSolutionError
        As `compare_mission`.
    """
    losses = design.losses
    if losses is None or losses.mission is None:
        return None
    return compare_mission(
        design.machine,
        design.inverter,
        losses.mission,
        Alternatives(losses.strategies, losses.modulations, (design.inverter.f_sw,)),
        i_max=design.i_max,
        options=BudgetOptions(design.machine_loss, design.winding, design.inverter.capacitor_esr),
        margin=design.operation.voltage_margin,
    )


@on_design("waveform")
def solve_phases(design: Design) -> PhaseFit:
    """Phase currents per torque of a design whose machine has a non-sinusoidal back-EMF."""
    machine, limits = require_phases(design), limits_of(design, design.waveform, 0.0)
    if isinstance(machine, SalientPhaseMachine):
        return fit_salient_phases(machine, limits, design.waveform)
    return fit_phases(machine, limits, design.waveform)


@on_design("field_weakening")
def solve_weakening(design: Design) -> WeakeningFit | None:
    """Two-dimensional reference of the design, None where it asks for none.

    Raises
    ------
    NoSolutionError
        As `fit_weakening`.
    """
    if design.weakening is None:
        return None
    operation = design.operation
    limit = voltage_limit(design.inverter, operation.modulation, operation.voltage_margin)
    return fit_weakening(design.machine, design.i_max, limit.v_max, design.weakening)


def gains_or_reason(design: Design) -> tuple[GainSet | None, str]:
    """Gains of the design, or None and why there are none where it can do without.

    Raises
    ------
    NoSolutionError
        As `solve_gains`, of a design that asks for control.
    """
    if design.control.gains == "none":
        return None, "control.gains is false"
    try:
        return solve_gains(design), ""
    except NoSolutionError as error:
        if design.control.gains == "required":
            raise
        return None, f"no loop was asked for and none was found: {error.message}"


@on_design("export.control")
def solve_fixed(design: Design, gains: GainSet) -> tuple[FixedControlFit, ...]:
    """Control functions in the fixed-point formats that the design asks for; errors as `fit_control`."""
    return fit_controls(design, (gains.i_d, gains.i_q, gains.speed), gains.observer)


@on_design("machine")
def solve(design: Design) -> Solution:
    """Solve everything that the design asks for.

    Raises
    ------
    InputError, NoSolutionError
        As the single steps do; the message names the section of the design.
    """
    positive = signed_designs(design)[0]
    chosen = solve_fit(positive)
    fit, (gains, left_out) = chosen.fit, gains_or_reason(design)
    return Solution(
        design=design,
        curves=solve_curves(positive),
        fit=fit,
        certificate=certify(current_choice(positive), fit.reference, fit.errors),
        trials=chosen.trials,
        alternatives=alternatives(current_choice(positive), fit),
        loops=gains,
        losses=solve_losses(design),
        waveforms=None if design.phase_machine is None else compare_waveforms(design),
        phases=None if design.phase_machine is None else solve_phases(design),
        weakening=solve_weakening(design),
        choice=solve_choice(design),
        mission=solve_mission(design),
        fixed=() if gains is None else solve_fixed(design, gains),
        data=chosen.data,
        gains_left_out=left_out,
        negative=solve_negative(design),
    )
