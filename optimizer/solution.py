"""One design, solved: the current reference, the gains and the loss comparison,
each with its evidence.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from dqforge.machines.design.design import Design
from dqforge.machines.design.numerical import on_design
from dqforge.machines.errors import InputError
from dqforge.machines.records import dataclass
from dqforge.optimizer.certificates.current_reference import Certificate, certify
from dqforge.optimizer.control_design.gain_set import GainSet, gains_or_reason
from dqforge.optimizer.current_reference.fit import (
    Alternative,
    ReferenceFit,
    alternatives,
    signed_designs,
    signed_reference,
)
from dqforge.optimizer.current_reference.solve import COVERED, DataUse, solve_fit
from dqforge.optimizer.current_reference.torque_band import TorqueBand, torque_band
from dqforge.optimizer.field_weakening.fit import solve_weakening
from dqforge.optimizer.firmware.solve import FirmwareFit, solve_firmware
from dqforge.optimizer.fixed_phase_control.solve import IntegerFit, solve_integers
from dqforge.optimizer.fixed_reference.fit import solve_fixed_references
from dqforge.optimizer.losses.solve import solve_losses, solve_mission
from dqforge.optimizer.operating_points.solve import Curves, current_choice, solve_curves

if TYPE_CHECKING:
    from dqforge.optimizer.application import ApplicationPlan
    from dqforge.optimizer.commissioning import CommissioningFit
    from dqforge.optimizer.current_feedback.regulator_runs import CurrentFeedback
    from dqforge.optimizer.current_reference.forms import Emitted
    from dqforge.optimizer.current_reference.solve import Trial
    from dqforge.optimizer.field_weakening.fit import WeakeningFit
    from dqforge.optimizer.fixed_observers.fixed_observer_fit import FixedObserverFit
    from dqforge.optimizer.fixed_reference.fit import FixedReferenceFit
    from dqforge.optimizer.frame_tables import FrameTables
    from dqforge.optimizer.losses.drive_comparison import MissionComparison
    from dqforge.optimizer.losses.phase_comparison import LossComparison
    from dqforge.optimizer.modulation_choice.solve import ModulationChoice
    from dqforge.optimizer.observers.reduced_order import ErrorsAtLoad
    from dqforge.optimizer.observers.tuning import ObserverProof
    from dqforge.optimizer.online_estimation import OnlineEstimationFit
    from dqforge.optimizer.overmodulation import Overmodulation
    from dqforge.optimizer.six_step.design import SixStepDesign
    from dqforge.optimizer.start_up.solve import StartUp
    from dqforge.optimizer.waveforms.comparison import WaveformComparison
    from dqforge.optimizer.waveforms.firmware_fit import PhaseFit


@dataclass(frozen=True, slots=True)
class NegativeHalf:
    """The reference of negative torques where the halves of a machine are kept,
    as that of the mirrored machine.
    """

    design: Design
    curves: Curves
    fit: ReferenceFit
    certificate: Certificate | None


@dataclass(frozen=True, slots=True)
class Solution:
    """Everything that a design asks for.

    ``losses`` is None where it asks for no comparison; ``waveforms`` and ``phases`` are None for
    machines with a sinusoidal back-EMF. ``certificate`` bounds the errors of the fit, None where
    that could not be proven; ``trials`` are the forms that were tried for a budget. ``weakening``
    is None where no two-dimensional reference, ``choice`` where no choice of modulator and
    switching frequency, ``mission`` where no mission is asked for. ``fixed`` are control functions
    in fixed point, ``fixed_observers`` the position observer. ``data`` says where the reference is
    held by the data of a flux map, or leaves them. ``loops`` is None where none are wanted, or
    where a design without a section ``control`` has none that hold; ``gains_left_out`` then says
    why. ``negative`` is None where one reference serves torques of both signs; else ``fit`` and
    ``certificate`` are those of positive ones. ``fixed_references`` lead from torque, dc link and
    speed to currents in fixed point. ``frame_tables`` and ``overmodulation`` are None where they
    are not asked for. ``firmware`` is what each firmware of others is given. ``observer_errors``
    are those of the speed observer at half the base speed, without load and with half the largest
    torque; empty without that observer. ``observer_proof`` is what is proven of the position
    observer, None without one. ``start_up`` is how the drive leaves standstill without an
    encoder, None where it does not. ``six_step`` is None where the design is no six-step drive.
    ``application`` are the settings of the program around the functions, None without one.
    ``torque_band`` is what the tolerances make of the torque, None without any that changes it.
    ``online_estimation`` is None where no parameter is estimated while the drive runs,
    ``commissioning`` where no tests are asked for.
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
    fixed: tuple[IntegerFit, ...] = ()
    fixed_observers: tuple[FixedObserverFit, ...] = ()
    data: DataUse = COVERED
    gains_left_out: str = ""
    negative: NegativeHalf | None = None
    observer_errors: tuple[ErrorsAtLoad, ...] = ()
    observer_proof: ObserverProof | None = None
    frame_tables: FrameTables | None = None
    overmodulation: Overmodulation | None = None
    fixed_references: tuple[FixedReferenceFit, ...] = ()
    firmware: tuple[FirmwareFit, ...] = ()
    start_up: StartUp | None = None
    six_step: SixStepDesign | None = None
    current_feedback: CurrentFeedback | None = None
    application: ApplicationPlan | None = None
    torque_band: TorqueBand | None = None
    online_estimation: OnlineEstimationFit | None = None
    commissioning: CommissioningFit | None = None

    @property
    def positive(self) -> Design:
        """The design as torques of the positive sign see it."""
        return signed_designs(self.design)[0]

    @property
    def reference(self) -> Emitted:
        """What the firmware evaluates for torques of both signs."""
        if self.negative is None:
            return self.fit.reference
        return signed_reference(self.fit, self.negative.fit)

    @property
    def gains(self) -> GainSet:
        """The gains, for what needs them.

        Raises:
            InputError: There are none.
        """
        if self.loops is None:
            raise InputError(f"this needs gains, and there are none: {self.gains_left_out}")
        return self.loops


def _observer_errors(
    design: Design, gains: GainSet | None, torque_max: float
) -> tuple[ErrorsAtLoad, ...]:
    """Errors of the speed observer without load and with half of ``torque_max`` N m.

    None without one.
    """
    if gains is None or gains.observer is None:
        return ()
    speed, loads = 0.5 * design.control.bases.speed, (0.0, 0.5 * torque_max)
    from dqforge.optimizer.observers.reduced_order import errors_at_loads

    return errors_at_loads(design.machine, gains.observer, speed, loads)


def _fixed_references(
    design: Design, gains: GainSet | None, fit: ReferenceFit, weakening: WeakeningFit | None
) -> tuple[FixedReferenceFit, ...]:
    """References for the control in rotor coordinates; none where there is none."""
    if gains is None or gains.phases is not None:
        return ()
    return solve_fixed_references(design, fit, weakening)


def _integers(
    design: Design, gains: GainSet, fit: ReferenceFit, references: tuple[FixedReferenceFit, ...]
) -> tuple[IntegerFit, ...]:
    """Control functions in fixed point, with their references."""
    known = {found.reference.width: found.reference for found in references}
    return solve_integers(design, gains, fit.torque_max, known)


# What not every design asks for is loaded where one does.


def _waveforms(design: Design) -> WaveformComparison | None:
    if design.phase_machine is None:
        return None
    from dqforge.optimizer.waveforms.comparison import compare_waveforms

    return compare_waveforms(design)


def _phases(design: Design) -> PhaseFit | None:
    if design.phase_machine is None:
        return None
    from dqforge.optimizer.waveforms.solve import solve_phases

    return solve_phases(design)


def _choice(design: Design) -> ModulationChoice | None:
    if design.modulation_choice is None:
        return None
    from dqforge.optimizer.modulation_choice.solve import solve_choice

    return solve_choice(design)


def _fixed_observers(design: Design, gains: GainSet | None) -> tuple[FixedObserverFit, ...]:
    if gains is None or gains.position is None:
        return ()
    from dqforge.optimizer.fixed_observers.fixed_observer_fit import solve_fixed_observers

    return solve_fixed_observers(design, gains.position)


def _observer_proof(gains: GainSet | None) -> ObserverProof | None:
    if gains is None or gains.position is None:
        return None
    from dqforge.optimizer.observers.tuning import prove

    return prove(gains.position)


def _frame_tables(design: Design) -> FrameTables | None:
    if not design.export.frame_tables:
        return None
    from dqforge.optimizer.frame_tables import solve_frame_tables

    return solve_frame_tables(design)


def _overmodulation(design: Design) -> Overmodulation | None:
    if design.inverter.overmodulation == "none":
        return None
    from dqforge.optimizer.overmodulation import solve_overmodulation

    return solve_overmodulation(design)


def _six_step(design: Design) -> SixStepDesign | None:
    if design.control.six_step is None:
        return None
    from dqforge.optimizer.six_step.design import solve_six_step

    return solve_six_step(design)


def _start_up(design: Design) -> StartUp | None:
    if design.control.start_up is None:
        return None
    from dqforge.optimizer.start_up.solve import solve_start_up

    return solve_start_up(design)


def _current_feedback(design: Design) -> CurrentFeedback | None:
    if not design.control.current_loop.switches:
        return None
    from dqforge.optimizer.current_feedback.closed_drive import lag_gains
    from dqforge.optimizer.current_feedback.regulator_runs import solve_current_feedback

    found = solve_current_feedback(design)
    return None if found is None else replace(found, gains=lag_gains(design, found))


def _application(design: Design) -> ApplicationPlan | None:
    if design.export.application is None:
        return None
    from dqforge.optimizer.application import application_plan

    return application_plan(design)


def _commissioning(design: Design) -> CommissioningFit | None:
    if design.control.commissioning is None:
        return None
    from dqforge.optimizer.commissioning import solve_commissioning

    return solve_commissioning(design)


def _online_estimation(design: Design) -> OnlineEstimationFit | None:
    if design.control.online_estimation is None:
        return None
    from dqforge.optimizer.online_estimation import solve_online_estimation

    return solve_online_estimation(design)


@on_design("machine")
def solve(design: Design) -> Solution:
    """Solve everything that the design asks for.

    Raises:
        InputError, NoSolutionError: As the single steps do; the message names the section of the
            design.
    """
    control = solve_control(design, proofs=True)
    fit, gains, positive = control.fit, control.loops, control.positive
    return replace(
        control,
        certificate=certify(current_choice(positive), fit.reference, fit.errors),
        alternatives=alternatives(current_choice(positive), fit),
        losses=solve_losses(design),
        waveforms=_waveforms(design),
        choice=_choice(design),
        mission=solve_mission(design),
        observer_errors=_observer_errors(design, gains, fit.torque_max),
        observer_proof=_observer_proof(gains),
        firmware=solve_firmware(design, gains),
        current_feedback=_current_feedback(design),
        torque_band=torque_band(
            positive.machine, control.curves.chosen, design.control.tolerances, fit.reference
        ),
    )


@on_design("machine")
def solve_control(design: Design, *, proofs: bool = False) -> Solution:
    """Solve what the emitted controller consists of, and nothing that judges or compares it.

    Args:
        design: The design.
        proofs: Of the gains, as in `solve_gains`.

    Raises:
        InputError, NoSolutionError: As `solve`.
    """
    positive = signed_designs(design)[0]
    chosen = solve_fit(positive)
    fit, (gains, left_out) = chosen.fit, gains_or_reason(design, proofs=proofs)
    weakening = solve_weakening(design)
    references = _fixed_references(design, gains, fit, weakening)
    return Solution(
        design=design,
        curves=solve_curves(positive),
        fit=fit,
        alternatives=(),
        loops=gains,
        losses=None,
        trials=chosen.trials,
        phases=_phases(design),
        weakening=weakening,
        fixed=() if gains is None else _integers(design, gains, fit, references),
        fixed_observers=_fixed_observers(design, gains),
        data=chosen.data,
        gains_left_out=left_out,
        negative=solve_negative(design),
        fixed_references=references,
        frame_tables=_frame_tables(design),
        overmodulation=_overmodulation(design),
        six_step=_six_step(design),
        start_up=_start_up(design),
        application=_application(design),
        online_estimation=_online_estimation(design),
        commissioning=_commissioning(design),
    )


# The reference of negative torques, where these have their own, solved and proven.


def solve_negative(design: Design) -> NegativeHalf | None:
    """Reference of negative torques of a design that keeps the halves of its machine apart.

    None for others.
    """
    mirrored = signed_designs(design)[1]
    if mirrored is None:
        return None
    found = solve_fit(mirrored).fit
    proof = certify(current_choice(mirrored), found.reference, found.errors)
    return NegativeHalf(mirrored, solve_curves(mirrored), found, proof)
