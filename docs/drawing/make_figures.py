"""Draw the figures of the documentation anew; the files are the same bytes every time.

The one figure of measured times, time-over-points.svg, is drawn by
`figures_operating_points.time_over_points` alone.
"""

from __future__ import annotations

from pathlib import Path

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

from dqforge.machines.design import catalogue
from dqforge.optimizer.current_reference.solve import solve_fit
from dqforge.optimizer.operating_points.solve import solve_curves
from dqforge.reports.current_reference.figures import plot_fit, plot_mtpa
from dqforge.reports.pages.figures_style import save


def main() -> None:
    """Write the figures into docs/figures."""
    folder = Path(__file__).resolve().parents[1] / "figures"
    folder.mkdir(exist_ok=True)
    design = catalogue.load("paper000-ipmsm-100kw")
    save(plot_mtpa(design, solve_curves(design)), folder / "mtpa.svg")
    figures_box_proofs.box_proof(folder / "box-proof.svg")
    save(plot_fit(design, solve_fit(design).fit), folder / "fit.svg")
    figures_fixed_point.sixteen_bits(folder / "fixed-point.svg")
    figures_fixed_control.integers_of_a_loop(folder / "fixed-control.svg")
    figures_fixed_reference.reference_in_integers(folder / "fixed-reference.svg")
    figures_firmware_loops.firmware_loops(folder / "firmware-loops.svg")
    for draw, name in (
        (figures_firmware_pages.eight_targets, "firmware-targets"),
        (figures_firmware_pages.vesc, "firmware-vesc"),
        (figures_firmware_pages.simplefoc, "firmware-simplefoc"),
        (figures_firmware_pages.odrive, "firmware-odrive"),
        (figures_firmware_pages.moteus, "firmware-moteus"),
        (figures_firmware_vendors.nxp, "firmware-nxp"),
        (figures_firmware_vendors.st, "firmware-st"),
        (figures_firmware_vendors.ti, "firmware-ti"),
        (figures_firmware_vendors.infineon, "firmware-infineon"),
        (figures_study_pages.sampling, "study-sampling"),
        (figures_study_pages.shared_steps, "study-shared-steps"),
        (figures_study_pages.parts, "study-parts"),
        (figures_study_pages.cluster, "study-cluster"),
    ):
        draw(folder / f"{name}.svg")
    figures_flux_maps.flux_map(folder / "flux-map.svg")
    figures_from_standstill.four_starts(folder / "from-standstill.svg")
    figures_home.machine_to_code(folder / "machine-to-code.svg")
    for draw, name in (
        (figures_gains.current_loop_step, "current-loop-step"),
        (figures_gains.gain_schedule, "gain-schedule"),
        (figures_gains.observer_error, "observer-error"),
    ):
        draw(folder / f"{name}.svg")
    figures_estimators.estimators(folder / "estimators.svg")
    figures_saliency.saliency(folder / "saliency.svg")
    figures_estimator_comparison.comparison(folder / "estimator-comparison.svg")
    figures_learned_correction.gain_over_speed(folder / "learned-correction.svg")
    figures_machine_batch.errors_over_tau(folder / "machine-batch.svg")
    figures_observers.position_errors(folder / "position-observers.svg")
    figures_observed_loops.corners_over_speed(folder / "observed-loops.svg")
    figures_operating_points.operating_points_map(folder / "operating-map.svg")
    figures_phase_control.torque_over_angle(folder / "phase-control.svg")
    figures_losses.modulation_waveforms(folder / "modulation-waveforms.svg")
    figures_modulation.zero_sequences(folder / "modulation-family.svg")
    figures_modulation.merits(folder / "modulation-merits.svg")
    figures_overmodulation.methods(folder / "overmodulation.svg")
    for draw, name in (
        (figures_explore.front, "study-front"),
        (figures_explore.yields, "study-yield"),
        (figures_current_feedback.regulators, "current-feedback"),
        (figures_current_feedback.hysteresis_over_speed, "hysteresis-frequency"),
        (figures_current_feedback.six_over_speed, "current-regulators"),
        (figures_explore_statistics.production, "explore-statistics"),
    ):
        draw(folder / f"{name}.svg")
    figures_losses.loss_comparison(folder / "loss-comparison.svg")
    figures_losses.loss_map(folder / "loss-map.svg")
    figures_speed_measurement.delay_and_margin(folder / "speed-measurement.svg")
    figures_six_step.start(folder / "six-step.svg")
    figures_start_up.starts(folder)
    figures_application.from_power_up_to_stop(folder / "application.svg")
    figures_simulation.bench(folder / "simulation.svg")
    figures_firmware_simulation.limit_cycle(folder / "firmware-simulation.svg")
    figures_simulation.dead_time(folder / "dead-time.svg")
    figures_start_up_bench.random_starts(folder / "start-up-bench.svg")
    figures_stability.periodic_stability(folder / "periodic-stability.svg")
    figures_losses.modulation_choice(folder / "modulation-choice.svg")
    figures_waveforms.phase_waveforms(folder / "phase-waveforms.svg")
    figures_waveforms.capture(folder / "back-emf.svg")
    figures_measured_drive.capture(folder / "measured-drive-capture.svg")
    figures_measured_drive.running(folder / "measured-drive-running.svg")
    figures_phase_design.torque_and_currents(folder / "phase-design.svg")
    figures_references.voltage_feedback(folder / "voltage-feedback.svg")
    figures_weakening.weakening_errors(folder / "weakening-errors.svg")
    figures_certificates.proven_bounds(folder / "certificate.svg")
    _guides(folder)


def _guides(folder: Path) -> None:
    """Those of the how-to pages, the reference, and of comparison, devices and loop proofs."""
    for draw, name in (
        (figures_comparison.sides, "compared-sides"),
        (figures_costs.control, "control-cost"),
        (figures_costs.reference, "reference-cost"),
        (figures_data_sheets.constants, "convert-constants"),
        (figures_data_sheets.scooter, "scooter-torque"),
        (figures_devices.library, "devices"),
        (figures_firmware_blocks.build, "header-build"),
        (figures_firmware_blocks.control_chain, "control-chain"),
        (figures_firmware_blocks.harness, "core-harness"),
        (figures_firmware_blocks.headers, "header-files"),
        (figures_hub_motor.explained, "hub-explained"),
        (figures_hub_motor.exported, "hub-exported"),
        (figures_hub_motor.tolerances, "hub-tolerances"),
        (figures_hub_motor.two_designs, "hub-two-designs"),
        (figures_loop_proofs.loop_proofs, "loop-proofs"),
        (figures_result_blocks.keys, "result-keys"),
        (figures_result_blocks.study, "study-course"),
        (figures_result_blocks.tree, "result-tree"),
    ):
        draw(folder / f"{name}.svg")


if __name__ == "__main__":
    main()
