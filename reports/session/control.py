"""Gains of loops and observers with their margins, and the simulated drive that runs on them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from dqforge.machines.records import dataclass
from dqforge.optimizer.control_design.gain_set import GainSet, solve_gains
from dqforge.optimizer.control_design.observed_refusal import require_observed
from dqforge.reports.loops.plain import plain_gains
from dqforge.reports.session.result import DrawnResult, dataset

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from dqforge.machines.arrays import FloatArray
    from dqforge.machines.design.design import Design
    from dqforge.optimizer.estimator_comparison.own_observer import ObserverEvidence
    from dqforge.optimizer.fixed_phase_control.solve import IntegerFit
    from dqforge.optimizer.observers.proof import ObserverProof
    from dqforge.reports.plain_data import PlainData
    from dqforge.reports.simulation.design_run import DriveSimulation, StepFigures


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Tuning(DrawnResult):
    """Gains of a design: ``gains.i_d``, ``gains.i_q``, ``gains.speed`` with kp,
    ki and margins in SI units.

    ``fixed`` are control functions in fixed point, ``proof`` what is proven of a position observer;
    both where the design asks for them. ``evidence`` has its errors on warm machines and the starts
    from which it locks, None without a position observer.
    """

    design: Design
    gains: GainSet
    fixed: tuple[IntegerFit, ...] = ()
    proof: ObserverProof | None = None
    evidence: ObserverEvidence | None = None

    def plain(self) -> PlainData:
        """By the keys of ``dqforge tune --json``."""
        plain: PlainData = {"gains": plain_gains(self.design, self.gains)}
        if self.gains.references is not None:
            from dqforge.reports.dynamic_references.tables import plain_references

            plain["dynamic_references"] = plain_references(self.gains.references)
        if self.gains.measured_speed is not None:
            from dqforge.reports.speed_measurement.tables import plain_measured

            plain["speed_measurement"] = plain_measured(self.gains.measured_speed)
        if self.proof is not None:
            plain["observer_proof"] = asdict(self.proof)
        if self.fixed:
            from dqforge.reports.phase_control.emitted_integers import plain_integer_evidence

            integers = {found.control.format: plain_integer_evidence(found) for found in self.fixed}
            plain["control_fixed"] = integers
        return plain | self._plain_evidence()

    def _plain_evidence(self) -> PlainData:
        if self.evidence is None:
            return {}
        from dqforge.reports.estimator_comparison.observer_errors import plain_capture, plain_warm

        return {
            "observer_warm": plain_warm(self.evidence.warm),
            "observer_capture": plain_capture(self.evidence.capture),
        }

    def figure(self) -> Figure:
        """Step responses and open loops with their margins."""
        from dqforge.reports.loops.figures import plot_gains

        return plot_gains(self.gains)


def tune(design: Design) -> Tuning:
    """Tune the loops and the observer of a design, each checked as it is sampled,
    and over its tolerances.

    Args:
        design: Its section ``control`` names methods, bandwidths in rad/s and tolerances.

    Raises:
        NoSolutionError: A loop is unstable or has less margin than required, nominally or at a
            corner of the tolerances; says where. On a position observer as `require_observed`.
    """
    gains = solve_gains(design)
    require_observed(design, gains)
    from dqforge.optimizer.estimator_comparison.own_observer import observer_evidence
    from dqforge.optimizer.fixed_phase_control.solve import solve_integers
    from dqforge.optimizer.observers.proof import prove

    fixed, proof = solve_integers(design, gains), prove(gains.position)
    return Tuning(design, gains, fixed, proof, observer_evidence(design, gains.position))


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class SimulatedDrive(DrawnResult):
    """A drive in the time domain with the emitted controller in the loop.

    Arrays of shape (N,) at its samples.

    ``found.run`` holds all records: phase quantities, duties, estimates.
    """

    found: DriveSimulation

    @property
    def t(self) -> FloatArray:
        """Time in s."""
        return self.found.run.t

    @property
    def omega_m(self) -> FloatArray:
        """Mechanical speed in rad/s."""
        return self.found.run.omega_m

    @property
    def torque(self) -> FloatArray:
        """Air-gap torque in N m."""
        return self.found.run.torque

    @property
    def i_d(self) -> FloatArray:
        """Current along the magnets in A (peak)."""
        return self.found.run.i_d

    @property
    def i_q(self) -> FloatArray:
        """Current across the magnets in A (peak)."""
        return self.found.run.i_q

    @property
    def reference(self) -> FloatArray:
        """What the drive was to follow: rad/s, N m or A, as ``found.unit`` says."""
        return self.found.run.reference

    @property
    def steps(self) -> tuple[StepFigures, ...]:
        """Rise, overshoot and settling of each step of the reference."""
        return self.found.steps

    def plain(self) -> PlainData:
        """By the keys of ``dqforge simulate --json``."""
        from dqforge.reports.simulation.tables import plain_simulation

        return plain_simulation(self.found)

    def figure(self) -> Figure:
        """Reference, controlled value, currents and duties over time."""
        from dqforge.reports.simulation.figures import plot_simulation

        return plot_simulation(self.found)

    def to_xarray(self) -> Any:
        """An xarray.Dataset over the time t; raises `InputError` where xarray is not installed."""
        units = {
            "omega_m": "rad/s",
            "torque": "N m",
            "i_d": "A",
            "i_q": "A",
            "reference": self.found.unit,
        }
        values = {name: (getattr(self, name), unit) for name, unit in units.items()}
        return dataset({"t": (self.t, "s")}, values, {"design": self.found.design.name})


def simulate(
    design: Design, *, switched: bool = False, progress: Callable[[float], None] | None = None
) -> SimulatedDrive:
    """Emit the controller of a design, compile it with the plant, and run the design's scenario.

    Args:
        design: With a section ``simulation``.
        switched: Whether every switching instant is simulated, whatever the section says.
        progress: Called with the share that is done, 0 to 1.

    Raises:
        InputError: There is no such section, or it does not fit the design.
        VerificationError: There is no C compiler.
    """
    from dqforge.reports.firmware.design_simulation import simulate_with_firmware

    return SimulatedDrive(simulate_with_firmware(design, switched=switched, progress=progress))
