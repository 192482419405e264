"""The eight switching states of a bridge, and the table that names one by sector and error.

A state is a code: bit 0 is leg a, bit 1 leg b, bit 2 leg c, set where the upper switch is on. The
active vectors stand at 0, 60, ... 300 degrees.

Sources: A. Nabae, S. Ogasawara, H. Akagi, "A novel control scheme for current-controlled PWM
inverters", IEEE Transactions on Industry Applications IA-22(4), 1986, pp. 697-701 (the table).
Paper 001 (Bezerra, COPPE/UFRJ 2004), section 6.2.4.3, names it twice, as [61] and as [65].
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import BoolArray, FloatArray
from dqforge.machines.names import SampledRuleName
from dqforge.machines.records import dataclass

Codes = NDArray[np.int64]

# Codes of the active states by the angle of their vector, in steps of 60 degrees.
ACTIVE: tuple[int, ...] = (1, 3, 2, 6, 4, 5)

# Legs of each code, shape (8, 3).
LEGS: BoolArray = np.array([[bool(code >> leg & 1) for leg in range(3)] for code in range(8)])

# Legs that commutate between two codes, shape (8, 8).
COMMUTATIONS: NDArray[np.int64] = np.array(
    [[bin(first ^ second).count("1") for second in range(8)] for first in range(8)]
)

_PLACES = ("own", "next", "next", "zero", "zero", "own")


def unit_vectors() -> FloatArray:
    """Vectors of the codes in the stator over the DC-link voltage, shape (8, 2): alpha and beta."""
    a, b, c = (LEGS[:, leg].astype(np.float64) for leg in range(3))
    return np.stack([(2.0 * a - b - c) / 3.0, (b - c) / math.sqrt(3.0)], axis=-1)


def switching_table() -> tuple[tuple[int, ...], ...]:
    """Code for each sector of the counter voltage and each region of the error, 6 by 6.

    The sector k lies between the active vectors k and k + 1, the region j within 30 degrees of the
    vector j. In the first sector the regions name V1, V2, V2, V0, V0, V1; each further sector turns
    all by 60 degrees. Of V0 and V7 the nearer one is meant; the table says 0.
    """
    rows = []
    for sector in range(6):
        names = {"own": ACTIVE[sector], "next": ACTIVE[(sector + 1) % 6], "zero": 0}
        rows.append(tuple(names[_PLACES[(region - sector) % 6]] for region in range(6)))
    return tuple(rows)


def codes_of(legs: BoolArray) -> Codes:
    """Codes (...) of switching states (..., 3)."""
    return np.asarray(legs @ np.array([1, 2, 4]), dtype=np.int64)


# Sampled rules that name the next switching state: predictive, circle, look-up table.
#
# Each is written once, in the order of operations of the emitted C, and runs on numpy arrays in
# double precision for analysis and in single precision as the model of the C. A rule is called at
# the start of a sampling period, knows the state that is on until its end, predicts the currents
# there, and names the state that is on from there: the computing time of one sample is part of it.
#
# Sources: paper 001 (Bezerra, COPPE/UFRJ 2004), sections 6.2.4.3 and 6.2.4.4; J. Holtz, S.
# Stadtfeld, "A predictive controller for the stator current vector of AC machines fed from a
# switched voltage source", IPEC Tokyo 1983, pp. 1665-1675 (circle, straight trajectories, time over
# commutations); the table: `state_table`.

Reals = NDArray[Any]

_TABLE, _ACTIVE = np.array(switching_table()), np.array(ACTIVE)

FAR = float(np.finfo(np.float32).max)

_PER_COMMUTATION = (1.0, 1.0, 0.5, 1.0 / 3.0)


@dataclass(frozen=True, slots=True)
class RuleConstants:
    """What a sampled rule knows of its drive, in SI units.

    Args:
        rule: Which rule.
        r_s, l_d, l_q, psi_pm: The machine: Ohm, H, H, Wb.
        t_s: Sampling period in s.
        band: Radius of the circle, or the error of a phase up to which the table keeps its state,
            in A; no part of the predictive rule.
        outer_band: Error of a phase in A beyond which the table takes the vector along the error.
    """

    rule: SampledRuleName
    r_s: float
    l_d: float
    l_q: float
    psi_pm: float
    t_s: float
    band: float = 0.0
    outer_band: float = 0.0


@dataclass(frozen=True, slots=True)
class RuleInputs:
    """What a rule is told at a sample, arrays of one shape (N,).

    References and currents in A (peak, rotor coordinates), cosine and sine of the electrical angle,
    electrical speed in rad/s, and DC-link voltage in V.
    """

    i_d_ref: Reals
    i_q_ref: Reals
    i_d: Reals
    i_q: Reals
    cosine: Reals
    sine: Reals
    omega_e: Reals
    v_dc: Reals

    def as_type(self, real: Any) -> RuleInputs:
        """The same in another precision."""
        columns = (
            self.i_d_ref,
            self.i_q_ref,
            self.i_d,
            self.i_q,
            self.cosine,
            self.sine,
            self.omega_e,
            self.v_dc,
        )
        return RuleInputs(*(np.asarray(column).astype(real) for column in columns))


class SampledRule:
    """A rule in one precision."""

    def __init__(self, constants: RuleConstants, real: Any = np.float64) -> None:
        self.constants, self.real = constants, real
        k = constants
        self.half = real(0.5 * k.t_s)
        self.gain_d, self.gain_q = real(k.t_s / k.l_d), real(k.t_s / k.l_q)
        self.r_s, self.l_d, self.l_q = real(k.r_s), real(k.l_d), real(k.l_q)
        self.psi_pm, self.band, self.outer = real(k.psi_pm), real(k.band), real(k.outer_band)
        self.square = real(self.band * self.band)
        vectors = unit_vectors().astype(real)
        self.u_alpha, self.u_beta = vectors[:, 0], vectors[:, 1]
        self.share = np.array(_PER_COMMUTATION, dtype=real)

    def next_codes(self, codes: Codes, told: RuleInputs) -> Codes:
        """Codes (N,) that are on from the next sample, for those (N,) that are on until then."""
        given = told.as_type(self.real)
        turn = given.omega_e * self.half
        slow = self.real(1.0) - self.real(0.5) * (turn * turn)
        fast = turn * (self.real(1.0) - (turn * turn) * self.real(1.0 / 6.0))

        def turned(c: Reals, s: Reals) -> tuple[Reals, Reals]:
            return c * slow - s * fast, s * slow + c * fast

        middle = turned(given.cosine, given.sine)
        end = turned(*middle)
        later = turned(*end)
        i_d, i_q = self._ahead(given, (given.i_d, given.i_q), codes, middle)
        if self.constants.rule == "look-up-table":
            return self._by_table(given, codes, (i_d, i_q), end)
        ends = self._ahead(given, (i_d, i_q), np.arange(8).reshape(8, *(1,) * codes.ndim), later)
        if self.constants.rule == "predictive":
            return self._least_error(given, codes, ends)
        return self._by_circle(given, codes, (i_d, i_q), ends)

    def _ahead(
        self,
        given: RuleInputs,
        current: tuple[Reals, Reals],
        codes: Codes,
        angle: tuple[Reals, Reals],
    ) -> tuple[Reals, Reals]:
        """Currents one sample ahead, with the voltage as it stands in the middle of the period."""
        (i_d, i_q), (c, s) = current, angle
        alpha, beta = self.u_alpha[codes] * given.v_dc, self.u_beta[codes] * given.v_dc
        v_d, v_q = c * alpha + s * beta, c * beta - s * alpha
        slope_d = (v_d - self.r_s * i_d) + given.omega_e * (self.l_q * i_q)
        slope_q = (v_q - self.r_s * i_q) - given.omega_e * (self.l_d * i_d + self.psi_pm)
        return i_d + self.gain_d * slope_d, i_q + self.gain_q * slope_q

    def _least_error(self, given: RuleInputs, codes: Codes, ends: tuple[Reals, Reals]) -> Codes:
        """Of equal errors that with the fewest commutations, then the first; nan keeps a state.

        ``ends`` are the currents (8, N) behind the second sample for each state.
        """
        e_d, e_q = given.i_d_ref - ends[0], given.i_q_ref - ends[1]
        errors = e_d * e_d + e_q * e_q
        best = np.full(codes.shape, FAR, dtype=self.real)
        moves, chosen = np.full(codes.shape, 4), codes.copy()
        for code, error in enumerate(errors):
            count = COMMUTATIONS[codes, code]
            better = (error < best) | ((error <= best) & (count < moves))
            best, moves = np.where(better, error, best), np.where(better, count, moves)
            chosen = np.where(better, code, chosen)
        return np.asarray(chosen)

    def _by_circle(
        self,
        given: RuleInputs,
        codes: Codes,
        current: tuple[Reals, Reals],
        ends: tuple[Reals, Reals],
    ) -> Codes:
        """Keep a state whose error is in the circle a sample later; else the longest time within
        the circle per commutation, and where none lasts a sample the least error.
        """
        zero, one = self.real(0.0), self.real(1.0)
        x, y = given.i_d_ref - current[0], given.i_q_ref - current[1]
        inside = (x * x + y * y) - self.square
        along, across = (given.i_d_ref - ends[0]) - x, (given.i_q_ref - ends[1]) - y
        last_d, last_q = x + along, y + across
        ended = last_d * last_d + last_q * last_q <= self.square
        a, b = along * along + across * across, x * along + y * across
        under = b * b - a * inside
        meets = (a > zero) & (under >= zero) & ((inside <= zero) | (b < zero))
        root = np.sqrt(np.where(meets, under, zero))
        times = np.where(meets, (root - b) / np.where(meets, a, one), zero)
        best, chosen = np.zeros(codes.shape, dtype=self.real), codes.copy()
        stays = np.zeros(codes.shape, dtype=np.bool_)
        for code, time in enumerate(times):
            stays |= (codes == code) & ended[code]
            score = time * self.share[COMMUTATIONS[codes, code]]
            better = (time >= one) & (score > best) & (codes != code)
            best, chosen = np.where(better, score, best), np.where(better, code, chosen)
        least = self._least_error(given, codes, ends)
        return np.asarray(np.where(stays, codes, np.where(best > zero, chosen, least)))

    def _by_table(
        self,
        given: RuleInputs,
        codes: Codes,
        current: tuple[Reals, Reals],
        angle: tuple[Reals, Reals],
    ) -> Codes:
        """Sector of the voltage that the references need, region of the predicted error."""
        (c, s), half, root = angle, self.real(0.5), self.real(0.5 * math.sqrt(3.0))
        x, y = given.i_d_ref - current[0], given.i_q_ref - current[1]
        alpha, beta = c * x - s * y, s * x + c * y
        errors = (alpha, root * beta - half * alpha, -(root * beta) - half * alpha)
        largest, region = np.abs(errors[0]), np.where(errors[0] >= 0.0, 0, 3)
        for leg in (1, 2):
            size = np.abs(errors[leg])
            above = size > largest
            largest = np.where(above, size, largest)
            region = np.where(above, (2 * leg + np.where(errors[leg] >= 0.0, 0, 3)) % 6, region)
        v_d = self.r_s * given.i_d_ref - given.omega_e * (self.l_q * given.i_q_ref)
        v_q = self.r_s * given.i_q_ref + given.omega_e * (self.l_d * given.i_d_ref + self.psi_pm)
        alpha, beta = c * v_d - s * v_q, s * v_d + c * v_q
        first, second = root * alpha + half * beta, root * alpha - half * beta
        upper = np.where(second >= 0.0, 0, np.where(first >= 0.0, 1, 2))
        lower = np.where(second < 0.0, 3, np.where(first < 0.0, 4, 5))
        sector = np.where(beta >= 0.0, upper, lower)
        named = _TABLE[sector, region]
        named = np.where(named == 0, nearer_zero(codes), named)
        named = np.where(largest > self.outer, _ACTIVE[region], named)
        return np.asarray(np.where(largest > self.band, named, codes))


def nearer_zero(codes: Codes) -> Codes:
    """That of the states 0 and 7 with fewer commutations from the codes (N,)."""
    return np.where(COMMUTATIONS[codes, 7] < COMMUTATIONS[codes, 0], 7, 0)
