"""The steps of the control of phase machines on numpy arrays of float32, many drives side by side.

The compiled code equals them bit for bit without contraction of products and
sums (-ffp-contract=off).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import fields
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.records import dataclass
from dqforge.machines.transforms import Pair
from dqforge.optimizer.curves.single_precision import SINGLE, SingleArray
from dqforge.optimizer.float_control.records import PiGains
from dqforge.optimizer.float_control.speed_loop import speed_loop
from dqforge.optimizer.phase_control.phase_records import (
    Control,
    ControlGains,
    Measured,
    Shape,
    Structure,
    TorqueLimit,
)
from dqforge.optimizer.phase_control.phase_steps import PhaseSteps, open_phase, phase_steps
from dqforge.optimizer.phase_control.torque_limits import Limited, LimitedSteps
from dqforge.optimizer.steps.step_arithmetic import Abc, Dq, where
from dqforge.reports.c_code.harness import single_from
from dqforge.reports.control.header import three_leg_duties
from dqforge.reports.plain_data import PlainData, shortest

if TYPE_CHECKING:
    from dqforge.optimizer.current_reference.forms import FloatReference
    from dqforge.optimizer.phase_control.phase_controller import LimitedShapes
    from dqforge.optimizer.waveforms.firmware_fit import PhaseReference


Singles = tuple[SingleArray, ...]


@dataclass(frozen=True, slots=True, eq=False)
class PhaseControlModel:
    """The control functions of one header.

    Args:
        structure: What its code is made of.
        gains: Members of ``<prefix>_control_gains_t`` by name, float32: ``d``, ``q``, ``zero`` and
            ``speed`` are (kp, ki_ts, tracking); numbers, or arrays of shape (N,) where drives
            differ.
        shape: Back-EMF over electrical speed in Wb, shape (1 or 3, nodes + 1).
        reference: Current references of the torque in the frame dq, else None.
        limit: Electrical speeds in rad/s, voltages in V and torques in N m; None without a table.
        v_nominal: Link voltage in V at which those speeds are the drive's; None where they are at
            any.
        limited: Currents beyond those in proportion to the torque, None without.
        waveform: Currents over torque and angle, None where they are in proportion to the torque.
    """

    structure: Structure
    gains: Mapping[str, Any]
    shape: SingleArray
    reference: FloatReference | None = None
    limit: tuple[SingleArray, SingleArray, SingleArray] | None = None
    v_nominal: np.float32 | None = None
    limited: LimitedSteps | None = None
    waveform: PhaseReference | None = None

    @property
    def numbers(self) -> ControlGains:
        """The gains as a record, with their tables."""
        found: dict[str, Any] = dict(self.gains)
        axes: dict[str, Any] = {
            name: PiGains(*found.pop(name)) for name in ("d", "q", "zero", "speed")
        }
        names = [member.name for member in fields(ControlGains)][4:-3]
        rest: dict[str, Any] = {name: found.get(name) for name in names}
        limit = None if self.limit is None else TorqueLimit(*self.limit)
        ratio: Any = self.structure.ratio
        return ControlGains(
            **axes, **rest, ratio=ratio, torque_limit=limit, shape=Shape(tuple(self.shape))
        )  # fmt: skip

    @property
    def steps(self) -> PhaseSteps:
        """What the C is written from."""
        nominal = None if self.v_nominal is None else float(self.v_nominal)
        currents = None if self.reference is None else self.reference.currents
        waveform = None if self.waveform is None else self._waveform
        return phase_steps(
            self.structure, self.shape, nominal, self.limited, currents, waveform
        )  # fmt: skip

    def _waveform(self, torque: SingleArray, sine: SingleArray, cosine: SingleArray) -> Singles:
        assert self.waveform is not None
        return tuple(self.waveform.currents(torque, (sine, cosine)))

    def measured(self, samples: SingleArray) -> Measured:
        """Samples of one instant: i_a, i_b, i_c, theta_e, omega_m, v_dc, v_m, shape (N, 6 or 7)."""
        columns = [np.ascontiguousarray(column) for column in samples.T]
        v_m = columns[6] if self.structure.midpoint else None
        theta_e, omega_m, v_dc = columns[3:6]
        return Measured(Abc(*columns[:3]), theta_e, omega_m, v_dc, v_m)

    def _run(
        self, step: Callable[..., Any], state: Control, measured: SingleArray, *asked: Any
    ) -> Singles:
        """Duty cycles that a step makes of samples as of `measured`."""
        with np.errstate(all="ignore"):
            return tuple(step(SINGLE, self.numbers, state, self.measured(measured), *asked))

    def control_step(
        self, state: Control, measured: SingleArray, reference: Singles, torque: SingleArray
    ) -> Singles:
        """Duty cycles from samples as of `measured`."""
        return self._run(self.steps.control_step, state, measured, Dq(*reference), torque)

    def duties(
        self, v: Pair[SingleArray], v_dc: SingleArray, current: Pair[SingleArray]
    ) -> Singles:
        """Duty cycles of three legs for a voltage (alpha, beta) in V."""
        return three_leg_duties(self.structure.modulation, v, v_dc, current)

    def limited_torque(self, torque: SingleArray, measured: SingleArray) -> SingleArray:
        """A torque in N m within the limits at samples as of `measured`."""
        gains = self.numbers
        with np.errstate(all="ignore"):
            omega_e, limits = gains.pole_pairs * measured[:, 4], self.steps.limits
            return limits.limited_torque(SINGLE, gains, torque, omega_e, measured[:, 5])

    def of_currents(self, measured: SingleArray, reference: Singles) -> tuple[Singles, SingleArray]:
        """References (d, q) in A with the torque in N m that `control_step` takes beside them."""
        samples = self.measured(measured)
        with np.errstate(all="ignore"):
            torque = self.steps.of_currents(SINGLE, self.numbers, samples, Dq(*reference))
        return reference, torque

    def of_torque(
        self, state: Control, measured: SingleArray, torque: SingleArray
    ) -> tuple[Singles, SingleArray]:
        """References (d, q) in A of a torque in N m, with what its limits leave of it."""
        samples = self.measured(measured)
        with np.errstate(all="ignore"):
            return self.steps.of_torque(SINGLE, self.numbers, state, samples, torque)

    def speed_loop(
        self, state: Control, measured: SingleArray, reference: SingleArray
    ) -> SingleArray:
        """Torque in N m for a speed in rad/s."""
        loop: Any = speed_loop
        omega_m = np.ascontiguousarray(measured[:, 4])
        torque: SingleArray = loop(SINGLE, self.numbers, state, omega_m, reference)
        return torque

    def current_control(self, state: Control, measured: SingleArray, reference: Singles) -> Singles:
        """Duty cycles for references (d, q) in A."""
        return self._run(self.steps.current_control, state, measured, Dq(*reference))

    def torque_control(self, state: Control, measured: SingleArray, torque: SingleArray) -> Singles:
        """Duty cycles for a torque in N m."""
        return self._run(self.steps.torque_control, state, measured, torque)

    def speed_control(
        self, state: Control, measured: SingleArray, reference: SingleArray
    ) -> Singles:
        """Duty cycles for a speed in rad/s."""
        return self._run(self.steps.speed_control, state, measured, reference)


def opened(state: Control, phase: NDArray[np.uint32], chosen: NDArray[np.bool_]) -> None:
    """Let a phase of the chosen drives carry no current from now on, 0 for none."""

    def now() -> None:
        open_phase(SINGLE, state, phase)

    where(SINGLE, chosen, now, state)


def plain_limited(limited: LimitedShapes | None) -> PlainData | None:
    """The table as plain data, every number a float32 value."""
    if limited is None:
        return None

    def singles(values: Any) -> Any:
        if np.ndim(values) == 0:
            return shortest(np.float32(values))
        return [singles(part) for part in values]

    closed = np.concatenate([limited.deviation, limited.deviation[..., :1]], axis=-1)
    return {
        "omega_e": singles(limited.omega_e),
        "plain": singles(limited.plain),
        "most": singles(limited.most),
        "current": singles(closed),
        "v_nominal": singles(limited.v_nominal),
        "mirrored": limited.mirrored,
    }


def limited_from(plain: Mapping[str, Any], shape: tuple[int, ...], neutral: bool) -> LimitedSteps:
    """The table from data as `plain_limited` makes them.

    ``shape`` is that of the table of the back-EMF, ``neutral`` says whether the legs drive a zero
    sequence. Raises KeyError, TypeError or ValueError where
    they are not.
    """

    def singles(values: Any) -> Any:
        return (
            [singles(part) for part in values] if isinstance(values, list) else single_from(values)
        )

    axes = {
        name: np.array(singles(plain[name]), dtype=np.float32)
        for name in ("omega_e", "plain", "most")
    }
    current = np.array(singles(plain["current"]), dtype=np.float32)
    count, nominal = axes["omega_e"].size, single_from(plain["v_nominal"])
    fits = current.ndim == 4 and current.shape[1] == count and current.shape[2] >= 2
    if not fits or (current.shape[0], current.shape[3]) != shape or count < 2:
        raise ValueError(current.shape)
    if any(axis.shape != (count,) for axis in axes.values()) or not nominal > 0.0:
        raise ValueError(count)
    if not np.all(np.diff(axes["omega_e"]) > 0.0) or not isinstance(plain["mirrored"], bool):
        raise ValueError(plain["mirrored"])
    table = Limited(axes["omega_e"], axes["plain"], axes["most"], tuple(current))
    return LimitedSteps(table, float(nominal), plain["mirrored"], neutral)
