"""The C functions of ``phase_control.h.j2`` on numpy arrays of float32, many drives side by side:
same operations, same bits.

The compiled code equals it bit for bit without contraction of products and
sums (-ffp-contract=off).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import field
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.records import dataclass
from dqforge.machines.transforms import Pair, Triple, clarke, park, park_inverse
from dqforge.optimizer.curves.single_precision import SINGLE, SingleArray
from dqforge.optimizer.float_control.records import Control, Pi
from dqforge.optimizer.float_control.speed_loop import speed_loop
from dqforge.optimizer.steps.step_arithmetic import AlphaBeta, Dq
from dqforge.reports.c_code.harness import rotation, single_from, small_rotation, turned, wrap
from dqforge.reports.control.header import gains_of, three_leg_duties
from dqforge.reports.phase_control.float32_parts import (
    Stationary,
    Turn,
    balanced,
    coupling,
    equal_load,
    from_frame,
    largest_torque,
    mean_of_phases,
    node_of,
    reference_at,
    rows_of,
    shape_at,
    slope_at,
    to_frame,
    topology_duties,
    turns_per_rad,
    voltage_share,
)
from dqforge.reports.plain_data import PlainData, shortest

if TYPE_CHECKING:
    from dqforge.optimizer.current_reference.forms import FloatReference
    from dqforge.optimizer.phase_control.phase_controller import LimitedShapes
    from dqforge.optimizer.waveforms.firmware_fit import PhaseReference
    from dqforge.reports.phase_control.float32_parts import Gains, Structure


Singles = tuple[SingleArray, ...]

_UNKNOWN, _FAR = np.float32(1.0e15), np.float32(65536.0)  # beyond, and not-a-number
_HALF, _ZERO, _ONE = np.float32(0.5), np.float32(0.0), np.float32(1.0)


@dataclass(slots=True)
class PhaseControlState:
    """State of N drives, arrays of shape (N,), as ``<prefix>_control_t``.

    ``harmonic`` and ``harmonic_zero`` hold real and imaginary parts by order.
    """

    d: SingleArray
    q: SingleArray
    zero: SingleArray
    speed: SingleArray
    reference: Singles
    v: Singles
    v_0: SingleArray
    omega_m: SingleArray
    torque: SingleArray
    count: NDArray[np.uint32]
    open: NDArray[np.uint32]
    harmonic: dict[int, Singles] = field(default_factory=dict)
    harmonic_zero: dict[int, Singles] = field(default_factory=dict)
    held: Singles = field(default_factory=lambda: (np.zeros(1, dtype=np.float32),) * 2)

    @classmethod
    def start(cls, count: int, structure: Structure) -> PhaseControlState:
        """Everything at rest."""

        def rest() -> SingleArray:
            return np.zeros(count, dtype=np.float32)

        words = np.zeros((2, count), dtype=np.uint32)
        return cls(
            rest(), rest(), rest(), rest(), (rest(), rest()), (rest(), rest()), rest(), rest(),
            rest(), words[0], words[1],
            {order: (rest(), rest()) for order in structure.plane},
            {order: (rest(), rest()) for order in structure.zero},
        )  # fmt: skip

    def open_phase(self, phase: NDArray[np.uint32], chosen: NDArray[np.bool_]) -> None:
        """Let a phase of the chosen drives carry no current from now on, 0 for none."""
        phase = np.where(phase > 3, 0, phase).astype(np.uint32)
        self.open = np.where(chosen, phase, self.open).astype(np.uint32)

        def reset(value: SingleArray) -> SingleArray:
            return np.where(chosen, _ZERO, value)

        self.d, self.q, self.zero = reset(self.d), reset(self.q), reset(self.zero)
        for kept in (self.harmonic, self.harmonic_zero):
            for order, parts in kept.items():
                kept[order] = tuple(reset(part) for part in parts)


@dataclass(frozen=True, slots=True)
class _Sample:
    """One sample of N drives: what is measured, and the angles that belong to it."""

    current: Stationary
    omega_e: SingleArray
    theta: SingleArray
    v_dc: SingleArray
    v_m: SingleArray | None
    now: Turn
    next: Turn
    acting: Turn
    last: Turn
    place: SingleArray
    step: SingleArray


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
    limited: LimitedTable | None = None
    waveform: PhaseReference | None = None

    def _sample(self, measured: SingleArray) -> _Sample:
        columns = [np.ascontiguousarray(column) for column in measured.T]
        i, theta, omega_m, v_dc = Triple(*columns[:3]), columns[3], columns[4], columns[5]
        omega_e, t_s = self.gains["pole_pairs"] * omega_m, self.gains["t_s"]
        now = rotation(theta)
        half = small_rotation(_HALF * (omega_e * t_s))
        following = turned(turned(now, half), half)
        acting = turned(following, half)
        plane = clarke(SINGLE, i)
        per_rad = turns_per_rad(self.structure.turns)
        return _Sample(
            Stationary(plane.x, plane.y, mean_of_phases(i)),
            omega_e, theta, v_dc, columns[6] if self.structure.midpoint else None,
            now, following, acting, turned(acting, half),
            (wrap(theta) if self.structure.turns == 1 else theta) * per_rad,
            (omega_e * t_s) * per_rad,
        )  # fmt: skip

    def _shape(self, state: PhaseControlState, place: SingleArray) -> Stationary:
        return shape_at(self.shape, place, state.open if self.structure.neutral else None)

    def _wanted(
        self,
        state: PhaseControlState,
        sample: _Sample,
        place: SingleArray,
        turn: Turn,
        reference: Singles,
        torque: SingleArray,
    ) -> Stationary:
        """Currents in A that belong to an angle."""
        made = self.structure
        if self.waveform is not None:
            found = self._waveform(state, sample, place, turn, reference, torque)
        elif made.by_torque:
            fade = self.gains["fade_end"] - (self.gains["fade"] * np.abs(sample.omega_e))
            fade = np.where(fade > _ONE, _ONE, np.where(fade > _ZERO, fade, _ZERO))
            fade = np.where(state.open != 0, _ONE, fade) if made.neutral else fade
            found = reference_at(
                self.gains, self._shape(state, place), turn, torque, reference[0], fade,
                self._zero_share(state, sample),
            )  # fmt: skip
        else:
            plane = park_inverse(SINGLE, (reference[0], reference[1]), turn)
            found = Stationary(plane.x, plane.y, np.zeros_like(torque))
            found = self._unless_open(state, place, turn, torque, found)
        if self.limited is not None:
            at = self.limited.place(torque, sample.omega_e, sample.v_dc, state.open)
            added = self.limited.deviation(at, place)
            zero = added.zero if made.neutral else np.zeros_like(torque)
            found = Stationary(
                found.alpha + added.alpha, found.beta + added.beta, found.zero + zero
            )
        if sample.v_m is None:
            return found
        balance = self.gains["balance"] * (sample.v_m - (_HALF * sample.v_dc))
        return balanced(found, self._shape(state, place), balance, state.open)

    def _waveform(
        self,
        state: PhaseControlState,
        sample: _Sample,
        place: SingleArray,
        turn: Turn,
        reference: Singles,
        torque: SingleArray,
    ) -> Stationary:
        """Currents in A of the header of phase currents; of the shape where a phase is open."""
        assert self.waveform is not None
        phase = Triple(*self.waveform.currents(torque, (turn[1], turn[0])))
        plane, d = clarke(SINGLE, phase), reference[0]
        zero = self._zero_share(state, sample) * mean_of_phases(phase)
        found = Stationary(plane.x + (d * turn[0]), plane.y + (d * turn[1]), zero)
        return self._unless_open(state, place, turn, torque, found)

    def _unless_open(
        self,
        state: PhaseControlState,
        place: SingleArray,
        turn: Turn,
        torque: SingleArray,
        currents: Stationary,
    ) -> Stationary:
        """Currents in A, but where a phase is open those of the shape of the others."""
        if not self.structure.neutral:
            return currents
        none, one = np.zeros_like(torque), np.ones_like(torque)
        shape, opened = self._shape(state, place), state.open != 0
        other = reference_at(self.gains, shape, turn, torque, none, one, one)
        return Stationary(*(np.where(opened, a, b) for a, b in zip(other, currents, strict=True)))

    def _zero_share(self, state: PhaseControlState, sample: _Sample) -> SingleArray:
        """Share of the shape's zero sequence in the references."""
        made, one = self.structure, np.ones_like(sample.omega_e)
        if not made.has_balance_share:
            return one if made.neutral else one - one
        share = (
            np.zeros_like(one)
            if made.frame == "dqx"
            else self.gains["zero_fade"] * np.abs(sample.omega_e)
        )
        return np.where((share > _ONE) | (state.open != 0), _ONE, share)

    def _controllers(
        self, state: PhaseControlState, sample: _Sample, error: Stationary
    ) -> tuple[Stationary, Stationary]:
        """Voltages of the PI controllers, and their integrals after this sample."""
        made, gains = self.structure, self.gains
        d, q = park(SINGLE, Pair(error.alpha, error.beta), sample.now)
        if made.follows:
            seen = to_frame(made.frame, self._shape(state, sample.place), error, gains["psi_pm"])
            integral = Stationary(
                state.d + (gains["d"][1] * seen.alpha),
                state.q + (gains["q"][1] * seen.beta),
                state.zero + (gains["zero"][1] * seen.zero) if made.neutral else np.zeros_like(d),
            )
            shape = self._shape(state, sample.place + (np.float32(1.5) * sample.step))
            kept = from_frame(made.frame, shape, integral, gains["psi_pm"])
        else:
            integral = Stationary(
                state.d + (gains["d"][1] * d),
                state.q + (gains["q"][1] * q),
                state.zero + (gains["zero"][1] * error.zero),
            )
            plane = park_inverse(SINGLE, (integral.alpha, integral.beta), sample.acting)
            kept = Stationary(plane.x, plane.y, integral.zero)
        part = park_inverse(SINGLE, (gains["d"][0] * d, gains["q"][0] * q), sample.now)
        zero = kept.zero + (gains["zero"][0] * error.zero) if made.neutral else np.zeros_like(d)
        return Stationary(kept.alpha + part.x, kept.beta + part.y, zero), integral

    def _fed(
        self,
        state: PhaseControlState,
        sample: _Sample,
        v: Stationary,
        reference: Singles,
        torque: SingleArray,
    ) -> Stationary:
        """The voltage with what is fed forward."""
        made, gains = self.structure, self.gains
        if made.feedforward == "none":
            return v
        f = self._shape(state, sample.place + (np.float32(1.5) * sample.step))
        v = Stationary(*(a + (sample.omega_e * b) for a, b in zip(v, f, strict=True)))
        if made.feedforward == "references":
            places = sample.place + sample.step, sample.place + (np.float32(2.0) * sample.step)
            first = self._wanted(state, sample, places[0], sample.next, reference, torque)
            second = self._wanted(state, sample, places[1], sample.last, reference, torque)
            half = _HALF * gains["r_s"]
            risen = self._risen(first, second, sample)
            v = Stationary(
                *(
                    (a + (half * (one + two))) + change
                    for a, one, two, change in zip(v, first, second, risen, strict=True)
                )
            )
        elif made.feedforward == "measured":
            part = self._coupling(state, sample, f)
            v = Stationary(*(a + b for a, b in zip(v, part, strict=True)))
        return v if made.neutral else v._replace(zero=np.zeros_like(v.zero))

    def _risen(self, first: Stationary, second: Stationary, sample: _Sample) -> Stationary:
        """Voltage that takes the flux linkage of the references from one sample to the next."""
        gains, rate = self.gains, self.gains["sampling"]
        zero = (gains["l_0"] * rate) * (second.zero - first.zero)
        if not self.structure.salient:
            per_ampere = gains["l_q"] * rate
            alpha, beta = (per_ampere * (b - a) for a, b in zip(first[:2], second[:2], strict=True))
            return Stationary(alpha, beta, zero)
        before, after = (
            self._linkage(i, turn) for i, turn in ((first, sample.next), (second, sample.last))
        )
        return Stationary(rate * (after.x - before.x), rate * (after.y - before.y), zero)

    def _linkage(self, i: Stationary, turn: Turn) -> Pair[SingleArray]:
        """Flux linkage in Wb of currents in A."""
        d, q = park(SINGLE, Pair(i.alpha, i.beta), turn)
        return park_inverse(SINGLE, (self.gains["l_d"] * d, self.gains["l_q"] * q), turn)

    def _coupling(self, state: PhaseControlState, sample: _Sample, f: Stationary) -> Stationary:
        """Voltage that the measured currents need, were they constant in their frame."""
        made, gains, current = self.structure, self.gains, sample.current
        if not made.follows:
            x = park(SINGLE, Pair(current.alpha, current.beta), sample.now)
            omega_e = sample.omega_e
            turning = -(omega_e * (gains["l_q"] * x.y)), omega_e * (gains["l_d"] * x.x)
            plane = park_inverse(SINGLE, turning, sample.acting)
            return Stationary(plane.x, plane.y, np.zeros_like(plane.x))
        seen = current if made.neutral else current._replace(zero=np.zeros_like(current.zero))
        inside = to_frame(made.frame, self._shape(state, sample.place), seen, gains["psi_pm"])
        place = sample.place + (np.float32(1.5) * sample.step)
        opened = state.open if made.neutral else None
        slope = slope_at(self.shape, place, opened, made.turns)
        return coupling(made.frame, gains, f, slope, inside, sample.omega_e)

    def control_step(
        self,
        state: PhaseControlState,
        measured: SingleArray,
        reference: Singles,
        torque: SingleArray,
    ) -> Singles:
        """Duty cycles from samples (N, 6 or 7): i_a, i_b, i_c, theta_e, omega_m, v_dc, v_m."""
        made, gains = self.structure, self.gains
        sample = self._sample(measured)
        wanted = self._wanted(state, sample, sample.place, sample.now, reference, torque)
        error = Stationary(*(a - b for a, b in zip(wanted, sample.current, strict=True)))
        if not made.neutral:
            error = error._replace(zero=np.zeros_like(error.zero))
        v, integral = self._controllers(state, sample, error)
        v = self._fed(state, sample, v, reference, torque)
        turning = Turning(gains, made, sample.omega_e, sample.now, sample.acting)
        if made.multiples:
            v = turning.voltage(state, v)
        size = (np.abs(v.alpha) + np.abs(v.beta)) + np.abs(v.zero)
        share = voltage_share(
            v, gains["voltage_share"], sample.v_dc, sample.v_m, made.topology, made.modulation
        )
        known = (size < _UNKNOWN) & (share >= _ZERO)
        known &= (np.abs(sample.theta) < _FAR) & (np.abs(sample.omega_e) < _UNKNOWN)
        free = share >= _ONE
        learning = known & free
        state.d = np.where(learning, integral.alpha, state.d)
        state.q = np.where(learning, integral.beta, state.q)
        if made.neutral:
            state.zero = np.where(learning, integral.zero, state.zero)
        if made.multiples:
            turning.learn(state, error, learning)
        v = Stationary(*(np.where(known, np.where(free, part, share * part), _ZERO) for part in v))
        state.reference, state.v, state.v_0 = reference, (v.alpha, v.beta), v.zero
        if not made.modulated:
            return topology_duties(v, sample.v_dc, sample.v_m, made.topology)
        current = Pair(sample.current.alpha, sample.current.beta)
        return three_leg_duties(made.modulation, Pair(v.alpha, v.beta), sample.v_dc, current)

    def duties(
        self, v: Pair[SingleArray], v_dc: SingleArray, current: Pair[SingleArray]
    ) -> Singles:
        """Duty cycles of three legs for a voltage (alpha, beta) in V."""
        return three_leg_duties(self.structure.modulation, v, v_dc, current)

    def limited_torque(self, torque: SingleArray, measured: SingleArray) -> SingleArray:
        """A torque in N m within the limits at samples as of `control_step`."""
        most = self.gains["torque_max"]
        if self.limit is not None:
            speeds, voltages, table = self.limit
            omega_e = np.abs(self.gains["pole_pairs"] * measured[:, 4])
            v_dc = measured[:, 5]
            if self.v_nominal is not None:
                omega_e = equal_load(omega_e, v_dc, self.v_nominal, speeds[-1])
            permitted = largest_torque((speeds, voltages), table, omega_e, v_dc)
            most = np.where(permitted < most, permitted, most)
        if self.limited is not None:
            speed = self.gains["pole_pairs"] * measured[:, 4]
            most = self.limited.largest_torque(torque, speed, measured[:, 5], most)
        low = np.where(torque < -most, -most, _ZERO)
        return np.where(torque > most, most, np.where(torque >= -most, torque, low))

    def of_currents(self, measured: SingleArray, reference: Singles) -> tuple[Singles, SingleArray]:
        """References (d, q) in A with the torque in N m that `control_step` takes beside them."""
        made, gains = self.structure, self.gains
        if not (made.by_torque or made.neutral):
            return reference, np.zeros_like(reference[0])
        per_ampere = (np.float32(1.5) * gains["pole_pairs"]) * gains["psi_pm"]
        return reference, self.limited_torque(per_ampere * reference[1], measured)

    def of_torque(
        self, state: PhaseControlState, measured: SingleArray, torque: SingleArray
    ) -> tuple[Singles, SingleArray]:
        """References (d, q) in A of a torque in N m, with what its limits leave of it."""
        made, held = self.structure, state.held
        per_ampere = (np.float32(1.5) * self.gains["pole_pairs"]) * self.gains["psi_pm"]
        asked = torque + (per_ampere * held[1]) if made.start_up and made.by_torque else torque
        limited = self.limited_torque(asked, measured)
        if self.reference is None:
            d = held[0] if made.start_up else _ZERO
            return (np.zeros_like(limited) + d, limited / per_ampere), limited
        reference = tuple(self.reference.currents(limited))
        if made.start_up:
            reference = (reference[0] + held[0], reference[1] + held[1])
        return reference, limited

    def speed_loop(
        self, state: PhaseControlState, measured: SingleArray, reference: SingleArray
    ) -> SingleArray:
        """Torque in N m for a speed in rad/s."""
        omega_m = np.ascontiguousarray(measured[:, 4])
        loop = Control(
            d=Pi(state.d),
            q=Pi(state.q),
            speed=Pi(state.speed),
            reference=Dq(*state.reference),
            v=AlphaBeta(*state.v),
            omega_m=state.omega_m,
            torque=state.torque,
            count=state.count,
        )
        gains = gains_of(self.gains, self.structure.ratio)
        torque = speed_loop(SINGLE, gains, loop, omega_m, reference)
        state.speed, state.omega_m = loop.speed.integral, loop.omega_m
        state.torque, state.count = loop.torque, loop.count
        return torque

    def current_control(
        self, state: PhaseControlState, measured: SingleArray, reference: Singles
    ) -> Singles:
        """Duty cycles for references (d, q) in A."""
        return self.control_step(state, measured, *self.of_currents(measured, reference))

    def torque_control(
        self, state: PhaseControlState, measured: SingleArray, torque: SingleArray
    ) -> Singles:
        """Duty cycles for a torque in N m."""
        state.torque = torque
        return self.control_step(state, measured, *self.of_torque(state, measured, torque))

    def speed_control(
        self, state: PhaseControlState, measured: SingleArray, reference: SingleArray
    ) -> Singles:
        """Duty cycles for a speed in rad/s."""
        torque = self.speed_loop(state, measured, reference)
        return self.torque_control(state, measured, torque)


# Currents beyond those in proportion to the torque on numpy arrays of float32: as ``limited.j2``,
# same bits.


@dataclass(frozen=True, slots=True)
class _Load:
    """Where a speed lies among the nodes: interval, share of it, and both torques there."""

    inside: NDArray[np.bool_]
    row: NDArray[np.int64]
    above: SingleArray
    plain: SingleArray
    most: SingleArray


@dataclass(frozen=True, slots=True)
class LimitedPlace:
    """Where an operating point lies in the table: intervals and shares of speed and torque.

    ``sign`` is 1 for motoring forwards, -1 for its mirror, 0 where the table adds nothing.
    """

    row: NDArray[np.int64]
    above: SingleArray
    column: NDArray[np.int64]
    beside: SingleArray
    sign: SingleArray


@dataclass(frozen=True, slots=True, eq=False)
class LimitedTable:
    """The table in float32.

    ``omega_e`` in rad/s, ``plain`` and ``most`` in N m, shape (W,); ``current`` in A, shape (1 or
    3, W, S, nodes + 1), the last node as the first; ``v_nominal`` in V.
    """

    omega_e: SingleArray
    plain: SingleArray
    most: SingleArray
    current: SingleArray
    v_nominal: np.float32
    mirrored: bool

    def _load(self, omega_e: SingleArray, v_dc: SingleArray) -> _Load:
        nodes = self.omega_e
        load = equal_load(np.abs(omega_e), v_dc, self.v_nominal, nodes[-1])
        row = np.zeros(load.shape, dtype=np.int64)
        for inner in nodes[1:-1]:
            row = row + (load > inner)
        above = (load - nodes[row]) / (nodes[row + 1] - nodes[row])
        above = np.where(above > _ONE, _ONE, np.where(above > _ZERO, above, _ZERO))
        plain, most = (
            table[row] + (above * (table[row + 1] - table[row]))
            for table in (self.plain, self.most)
        )
        forward = omega_e >= _ZERO
        inside = (load >= nodes[0]) & (forward | np.bool_(self.mirrored))
        return _Load(inside, row, above, plain, most)

    def largest_torque(
        self, torque: SingleArray, omega_e: SingleArray, v_dc: SingleArray, most: SingleArray
    ) -> SingleArray:
        """The larger of a limit and that of the table, in N m, for motoring torques; shape (N,)."""
        found = self._load(omega_e, v_dc)
        motors = found.inside & ((torque * omega_e) > _ZERO) & (found.most > most)
        return np.where(motors, found.most, most)

    def place(
        self,
        torque: SingleArray,
        omega_e: SingleArray,
        v_dc: SingleArray,
        opened: NDArray[np.uint32],
    ) -> LimitedPlace:
        """Where torques in N m, speeds in rad/s and links in V lie, shape (N,)."""
        found = self._load(omega_e, v_dc)
        motors = found.inside & ((torque * omega_e) > _ZERO) & (opened == 0)
        span = found.most - found.plain
        there = span > _ZERO
        share = np.where(there, (np.abs(torque) - found.plain) / np.where(there, span, _ONE), _ZERO)
        share = np.where(share > _ONE, _ONE, np.where(share > _ZERO, share, _ZERO))
        steps = self.current.shape[2] - 1
        share = share * np.float32(steps)
        column = np.minimum(share.astype(np.int64), steps - 1)
        sign = np.where(omega_e < _ZERO, -_ONE, _ONE)
        return LimitedPlace(
            found.row, found.above, column, share - column.astype(np.float32),
            np.where(motors, sign, _ZERO),
        )  # fmt: skip

    def deviation(self, at: LimitedPlace, place: SingleArray) -> Stationary:
        """Currents in A to add, at a place in lengths of the table, shape (N,)."""
        k, share = node_of(self.current.shape[-1] - 1, at.sign * place)
        corners = []
        for i, weight_i in ((0, _ONE - at.above), (1, at.above)):
            for j, weight_j in ((0, _ONE - at.beside), (1, at.beside)):
                table = self.current[:, at.row + i, at.column + j]
                rows = rows_of(table, k)
                corners.append((weight_i * weight_j, rows))
        phases = []
        for phase in range(3):
            total = np.zeros_like(place)
            for weight, rows in corners:
                here, there = rows[phase]
                total = total + (weight * (here + (share * (there - here))))
            phases.append(total)
        values = Triple(*phases)
        plane, size = clarke(SINGLE, values), np.abs(at.sign)
        return Stationary(size * plane.x, at.sign * plane.y, size * mean_of_phases(values))


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


def limited_from(plain: Mapping[str, Any], shape: tuple[int, ...]) -> LimitedTable:
    """The table from data as `plain_limited` makes them.

    ``shape`` is that of the table of the back-EMF. Raises KeyError, TypeError or ValueError where
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
    return LimitedTable(
        axes["omega_e"], axes["plain"], axes["most"], current, np.float32(nominal),
        plain["mirrored"],
    )  # fmt: skip


# Harmonic integrators of the control of phase machines on numpy arrays of float32: as
# ``harmonics.j2``, same operations, same bits.


class Integrals(Protocol):
    """Real and imaginary parts by order, arrays of shape (N,)."""

    harmonic: dict[int, tuple[SingleArray, ...]]
    harmonic_zero: dict[int, tuple[SingleArray, ...]]


def multiples_of(turn: Turn, orders: Sequence[int]) -> dict[int, Turn]:
    """Cosine and sine of multiples of an angle, ascending, by recurrence."""
    twice, x, reached, found = turned(turn, turn), turn, 1, {}
    for order in orders:
        for _ in range((order - reached) // 2):
            x = turned(x, twice)
        if (order - reached) % 2:
            x = turned(x, turn)
        reached, found[order] = order, x
    return found


def harmonic_share(gains: Gains, order: int, omega_e: SingleArray) -> SingleArray:
    """Share of a harmonic at an electrical speed in rad/s."""
    share = np.float32(5.0) - (gains["harmonic_fade"] * np.abs(np.float32(order) * omega_e))
    return np.where(share > _ONE, _ONE, np.where(share > _ZERO, share, _ZERO))


def signed_turn(multiples: Mapping[int, Turn], order: int) -> Turn:
    """Rotation of a signed order."""
    cosine, sine = multiples[abs(order)]
    return cosine, (-sine if order < 0 else sine)


def harmonic_gain(
    kp: Any, r_s: Any, reactance: SingleArray, now: Turn, acting: Turn
) -> tuple[SingleArray, SingleArray]:
    """What turns an integral into its voltage, real and imaginary part in V/A.

    Args:
        kp: Of the controller in V/A.
        r_s, reactance: Of the machine at the harmonic, in Ohm.
        now, acting: Multiples of the angles of the sample and of the voltage.
    """
    return (
        (kp * now[0]) + ((r_s * acting[0]) - (reactance * acting[1])),
        (kp * now[1]) + ((r_s * acting[1]) + (reactance * acting[0])),
    )


@dataclass(frozen=True, slots=True)
class Turning:
    """The integrators at one sample of N drives.

    Args:
        gains, made: As of the model.
        omega_e: Electrical speed in rad/s, shape (N,).
        now, acting: Angles of the sample and of the voltage.
    """

    gains: Gains
    made: Structure
    omega_e: SingleArray
    now: Turn
    acting: Turn

    def voltage(self, state: Integrals, v: Stationary) -> Stationary:
        """A voltage in V with that of all integrals."""
        made, gains = self.made, self.gains
        now = multiples_of(self.now, made.multiples)
        acting = multiples_of(self.acting, made.multiples)
        alpha, beta, zero = v
        kp = _HALF * (gains["d"][0] + gains["q"][0])
        inductance = _HALF * (gains["l_d"] + gains["l_q"])
        for order in made.plane:
            share = harmonic_share(gains, order, self.omega_e)
            reactance = (np.float32(order) * self.omega_e) * inductance
            turns = signed_turn(now, order), signed_turn(acting, order)
            x, y = harmonic_gain(kp, gains["r_s"], reactance, *turns)
            r = state.harmonic[order]
            alpha = alpha + (share * ((r[0] * x) - (r[1] * y)))
            beta = beta + (share * ((r[0] * y) + (r[1] * x)))
        for order in made.zero:
            share = harmonic_share(gains, order, self.omega_e)
            reactance = (np.float32(order) * self.omega_e) * gains["l_0"]
            turns = now[order], acting[order]
            x, y = harmonic_gain(gains["zero"][0], gains["r_s"], reactance, *turns)
            r = state.harmonic_zero[order]
            zero = zero + (share * ((r[0] * x) - (r[1] * y)))
        return Stationary(alpha, beta, zero)

    def learn(self, state: Integrals, error: Stationary, learning: NDArray[np.bool_]) -> None:
        """The step of all integrals where they learn, for errors in A."""
        made, gains = self.made, self.gains
        size = (np.abs(error.alpha) + np.abs(error.beta)) + np.abs(error.zero)
        learning = learning & (size <= gains["harmonic_error_max"])
        now = multiples_of(self.now, made.multiples)
        for order in made.plane:
            cosine, sine = signed_turn(now, order)
            rate = gains["harmonic_rate"] * harmonic_share(gains, order, self.omega_e)
            r = state.harmonic[order]
            x = r[0] + (rate * ((error.alpha * cosine) + (error.beta * sine)))
            y = r[1] + (rate * ((error.beta * cosine) - (error.alpha * sine)))
            state.harmonic[order] = np.where(learning, x, r[0]), np.where(learning, y, r[1])
        for order in made.zero:
            cosine, sine = now[order]
            rate = gains["harmonic_rate"] * harmonic_share(gains, order, self.omega_e)
            r = state.harmonic_zero[order]
            x, y = r[0] + (rate * (error.zero * cosine)), r[1] - (rate * (error.zero * sine))
            state.harmonic_zero[order] = np.where(learning, x, r[0]), np.where(learning, y, r[1])
