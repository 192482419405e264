"""The eight switching states of a bridge, and the table that names one by sector and error.

A state is a code: bit 0 is leg a, bit 1 leg b, bit 2 leg c, set where the upper switch is on. The
active vectors stand at 0, 60, ... 300 degrees.

Sources: A. Nabae, S. Ogasawara, H. Akagi, "A novel control scheme for current-controlled PWM
inverters", IEEE Transactions on Industry Applications IA-22(4), 1986, pp. 697-701 (the table).
Paper 001 (Bezerra, COPPE/UFRJ 2004), section 6.2.4.3, names it twice, as [61] and as [65].
"""

from __future__ import annotations

import math
from typing import Any, Protocol

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


Reals = NDArray[Any]


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


class NextCodes(Protocol):
    """A rule that names the next switching state at each sample."""

    def __call__(self, constants: RuleConstants, codes: Codes, /, *told: Reals) -> Codes:
        """Codes (N,) that are on from the next sample, for those (N,) that are on until then.

        Args:
            constants: The rule and what it knows of its drive.
            codes: The states.
            told: At the sample, shape (N,) each: references and currents (d, q each) in A, cosine
                and sine of the electrical angle, electrical speed in rad/s, DC-link voltage in V.
        """
