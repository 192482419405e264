"""How the numbers of an ODrive 0.5 are meant, and what in them does not fit together."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from dqforge.optimizer.firmware.one_bandwidth.moteus_sentences import overshoot

Values = Mapping[str, float | int | bool]

# ``pm_flux_linkage`` of the sensorless estimator in Wb while nobody sets it.
DEFAULT_FLUX = 1.58e-3
DEFAULT_TORQUE_CONSTANT = 0.04  # In N m/A, likewise.
GIMBAL = 2  # Motor type for which amperes are meant as volts.
HALL = 1  # Mode of an encoder that is three Hall sensors.


def conventions(values: Values) -> Iterator[str]:
    """Sentences on how numbers are meant that a reader could take otherwise.

    Args:
        values: By name below the axis.
    """
    constant = _positive(values, "motor.config.torque_constant")
    if constant is not None:
        yield (
            f"torque_constant {constant:.6g} N m/A (peak of phase) is 8.27/KV: KV "
            f"{8.26993 / constant:.5g} rpm per volt between two phases (peak)"
        )
    elif "controller.config.vel_limit" in values:
        yield (
            "the file has no torque_constant, as before 0.5.1: in 0.4 speeds and gains were counts "
            "of the encoder, here they are taken as turns; check vel_limit"
        )
    if "motor.config.phase_inductance" in values:
        yield "phase_inductance stands for both axes"
    if "controller.config.vel_gain" in values:
        yield "vel_gain and vel_integrator_gain are in N m per turn/s and N m per turn"
    if values.get("motor.config.R_wL_FF_enable"):
        yield from _feedforward(values)


def contradictions(values: Values, period: float) -> Iterator[str]:
    """Sentences on what does not fit together.

    Args:
        values: By name below the axis.
        period: Of the control in s.
    """
    yield from _torque_constant(values)
    yield from _encoder(values, period)
    limit = _positive(values, "motor.config.current_lim")
    reach = _positive(values, "motor.config.requested_current_range")
    if limit is not None and reach is not None and limit > reach:
        yield (
            f"current_lim {limit:g} A is above requested_current_range {reach:g} A: the drive "
            "limits to what its amplifiers measure"
        )
    bandwidth = _positive(values, "motor.config.current_control_bandwidth")
    if bandwidth is not None and bandwidth * period > 0.5:
        yield (
            f"current_control_bandwidth {bandwidth:g} rad/s times the control's {period * 1e6:g} "
            f"us is {bandwidth * period:.2f}: above 0.5 the current loops ring"
        )
    if values.get("motor.config.pre_calibrated") and not (
        _positive(values, "motor.config.phase_resistance")
        and _positive(values, "motor.config.phase_inductance")
    ):
        yield "pre_calibrated is true, but phase_resistance or phase_inductance is zero"


def _positive(values: Values, key: str) -> float | None:
    value = values.get(key, 0.0)
    return float(value) if value > 0.0 else None


def _feedforward(values: Values) -> Iterator[str]:
    r_s = _positive(values, "motor.config.phase_resistance")
    inductance = _positive(values, "motor.config.phase_inductance")
    bandwidth = _positive(values, "motor.config.current_control_bandwidth")
    if r_s is not None and inductance is not None and bandwidth is not None:
        more = overshoot(1.0, bandwidth * inductance / r_s)
        yield (
            "R_wL_FF_enable adds R and omega L times the references to the voltages: a step of the "
            f"q current overshoots by {more:.1%}, the margins stay"
        )


def _torque_constant(values: Values) -> Iterator[str]:
    constant = _positive(values, "motor.config.torque_constant")
    flux = _positive(values, "sensorless_estimator.config.pm_flux_linkage")
    pairs = _positive(values, "motor.config.pole_pairs")
    if constant == DEFAULT_TORQUE_CONSTANT:
        yield "torque_constant 0.04 N m/A is what ODrive ships: 8.27/KV was not written there"
    elif constant and flux and pairs and abs(flux / DEFAULT_FLUX - 1.0) > 1e-4:
        made = 1.5 * pairs * flux
        if abs(made / constant - 1.0) > 0.02:
            yield (
                f"torque_constant {constant:.5g} N m/A is not 1.5 pole_pairs pm_flux_linkage = "
                f"{made:.5g} N m/A: one of them is of another motor"
            )


def _encoder(values: Values, period: float) -> Iterator[str]:
    bandwidth = _positive(values, "encoder.config.bandwidth")
    if bandwidth is not None and 2.0 * bandwidth * period >= 1.0:
        yield (
            f"encoder.config.bandwidth {bandwidth:g} rad/s: kp T = {2.0 * bandwidth * period:.3g} "
            "is not below 1, and ODrive stops with ERROR_UNSTABLE_GAIN"
        )
    pairs, counts = values.get("motor.config.pole_pairs"), values.get("encoder.config.cpr")
    if values.get("encoder.config.mode") == HALL and pairs and counts and counts != 6 * pairs:
        yield (
            f"encoder.config.cpr {counts:g} with Hall sensors is not 6 pole_pairs = {6 * pairs:g}"
        )
