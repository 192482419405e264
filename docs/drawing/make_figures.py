"""Draw the figures of the documentation anew, or those that are named; the files are the same bytes
every time.

The one figure of measured times, time-over-points.svg, is drawn by
`figures_operating_points.time_over_points` alone.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import _kernels  # noqa: F401
import figures_application
import figures_box_proofs
import figures_certificates
import figures_comparison
import figures_costs
import figures_current_feedback
import figures_data_sheets
import figures_devices
import figures_estimator_comparison
import figures_estimators
import figures_explore
import figures_explore_statistics
import figures_firmware_blocks
import figures_firmware_loops
import figures_firmware_pages
import figures_firmware_simulation
import figures_firmware_vendors
import figures_fixed_control
import figures_fixed_point
import figures_fixed_reference
import figures_flux_maps
import figures_from_standstill
import figures_gains
import figures_home
import figures_hub_motor
import figures_learned_correction
import figures_loop_proofs
import figures_losses
import figures_machine_batch
import figures_measured_drive
import figures_modulation
import figures_observed_loops
import figures_observers
import figures_online_estimation
import figures_operating_points
import figures_overmodulation
import figures_phase_control
import figures_phase_design
import figures_references
import figures_result_blocks
import figures_saliency
import figures_simulation
import figures_six_step
import figures_speed_measurement
import figures_stability
import figures_start_up
import figures_start_up_bench
import figures_study_pages
import figures_waveforms
import figures_weakening

FIGURES: dict[str, Callable[[Path], None]] = {
    "application": figures_application.from_power_up_to_stop,
    "back-emf": figures_waveforms.capture,
    "box-proof": figures_box_proofs.box_proof,
    "certificate": figures_certificates.proven_bounds,
    "compared-sides": figures_comparison.sides,
    "control-chain": figures_firmware_blocks.control_chain,
    "control-cost": figures_costs.control,
    "convert-constants": figures_data_sheets.constants,
    "core-harness": figures_firmware_blocks.harness,
    "current-feedback": figures_current_feedback.regulators,
    "current-loop-step": figures_gains.current_loop_step,
    "current-regulators": figures_current_feedback.six_over_speed,
    "dead-time": figures_simulation.dead_time,
    "devices": figures_devices.library,
    "estimator-comparison": figures_estimator_comparison.comparison,
    "estimators": figures_estimators.estimators,
    "explore-statistics": figures_explore_statistics.production,
    "firmware-infineon": figures_firmware_vendors.infineon,
    "firmware-loops": figures_firmware_loops.firmware_loops,
    "firmware-moteus": figures_firmware_pages.moteus,
    "firmware-nxp": figures_firmware_vendors.nxp,
    "firmware-odrive": figures_firmware_pages.odrive,
    "firmware-simplefoc": figures_firmware_pages.simplefoc,
    "firmware-simulation": figures_firmware_simulation.limit_cycle,
    "firmware-st": figures_firmware_vendors.st,
    "firmware-targets": figures_firmware_pages.eight_targets,
    "firmware-ti": figures_firmware_vendors.ti,
    "firmware-vesc": figures_firmware_pages.vesc,
    "fit": figures_operating_points.fit,
    "fixed-control": figures_fixed_control.integers_of_a_loop,
    "fixed-point": figures_fixed_point.sixteen_bits,
    "fixed-reference": figures_fixed_reference.reference_in_integers,
    "flux-map": figures_flux_maps.flux_map,
    "from-standstill": figures_from_standstill.four_starts,
    "gain-schedule": figures_gains.gain_schedule,
    "header-build": figures_firmware_blocks.build,
    "header-files": figures_firmware_blocks.headers,
    "hub-explained": figures_hub_motor.explained,
    "hub-exported": figures_hub_motor.exported,
    "hub-tolerances": figures_hub_motor.tolerances,
    "hub-two-designs": figures_hub_motor.two_designs,
    "hysteresis-frequency": figures_current_feedback.hysteresis_over_speed,
    "learned-correction": figures_learned_correction.gain_over_speed,
    "loop-proofs": figures_loop_proofs.loop_proofs,
    "loss-comparison": figures_losses.loss_comparison,
    "loss-map": figures_losses.loss_map,
    "machine-batch": figures_machine_batch.errors_over_tau,
    "machine-to-code": figures_home.machine_to_code,
    "measured-drive-capture": figures_measured_drive.capture,
    "measured-drive-running": figures_measured_drive.running,
    "modulation-choice": figures_losses.modulation_choice,
    "modulation-family": figures_modulation.zero_sequences,
    "modulation-merits": figures_modulation.merits,
    "modulation-waveforms": figures_losses.modulation_waveforms,
    "mtpa": figures_operating_points.mtpa,
    "observed-loops": figures_observed_loops.corners_over_speed,
    "observer-error": figures_gains.observer_error,
    "online-estimation": figures_online_estimation.warm_windings,
    "operating-map": figures_operating_points.operating_points_map,
    "overmodulation": figures_overmodulation.methods,
    "periodic-stability": figures_stability.periodic_stability,
    "phase-control": figures_phase_control.torque_over_angle,
    "phase-design": figures_phase_design.torque_and_currents,
    "phase-waveforms": figures_waveforms.phase_waveforms,
    "position-observers": figures_observers.position_errors,
    "reference-cost": figures_costs.reference,
    "result-keys": figures_result_blocks.keys,
    "result-tree": figures_result_blocks.tree,
    "rotor-angle": figures_flux_maps.rotor_angle,
    "saliency": figures_saliency.saliency,
    "scooter-torque": figures_data_sheets.scooter,
    "simulation": figures_simulation.bench,
    "six-step": figures_six_step.start,
    "speed-measurement": figures_speed_measurement.delay_and_margin,
    "start-up": figures_start_up.start_and_back,
    "start-up-bench": figures_start_up_bench.random_starts,
    "start-up-third-harmonic": figures_start_up.start_on_the_third_harmonic,
    "study-cluster": figures_study_pages.cluster,
    "study-course": figures_result_blocks.study,
    "study-front": figures_explore.front,
    "study-parts": figures_study_pages.parts,
    "study-sampling": figures_study_pages.sampling,
    "study-shared-steps": figures_study_pages.shared_steps,
    "study-yield": figures_explore.yields,
    "voltage-feedback": figures_references.voltage_feedback,
    "weakening-errors": figures_weakening.weakening_errors,
}
"""Every figure by the name of its file, with what draws it."""


def main(names: Sequence[str]) -> None:
    """Write the figures of these names, or all, into docs/figures."""
    folder = Path(__file__).resolve().parents[1] / "figures"
    folder.mkdir(exist_ok=True)
    for name in names or FIGURES:
        FIGURES[name](folder / f"{name}.svg")


if __name__ == "__main__":
    main(sys.argv[1:])
