"""Macros of ST's MCSDK that are read and written, by file, with what they mean.

Names that only the motor file has (`ld_lq_ratio`, `inertia`, `friction`) stand beside those of the
headers.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.machines.records import dataclass

# Of the format that is written; version 5 differs in the names of OTHERWISE and in the circle
# limitation.
VERSION = "6"

MOTOR = {
    "POLE_PAIR_NUM": "pole pairs",
    "RS": "resistance of a phase, ohm",
    "LS": "inductance of a phase along q, H",
    "MOTOR_VOLTAGE_CONSTANT": "back-EMF, V r.m.s. line to line per 1000 rpm",
    "MOTOR_MAX_SPEED_RPM": "largest speed of the motor, rpm",
    "NOMINAL_CURRENT_A": "largest current, A peak of phase",
    "ID_DEMAG_A": "d current down to which the field is weakened, A",
}

STAGE = {
    "NOMINAL_BUS_VOLTAGE_V": "dc link, V",
    "RSHUNT": "shunt, ohm",
    "AMPLIFICATION_GAIN": "gain behind it",
    "ADC_REFERENCE_VOLTAGE": "reference of the converter, V",
}

DRIVE = {
    "MAX_APPLICATION_SPEED_RPM": "largest speed of the drive, rpm",
    "PWM_FREQUENCY": "carrier, Hz",
    "PWM_FREQ_SCALING": "by which the carrier frequency is divided to fit 16 bits",
    "REGULATION_EXECUTION_RATE": "carrier periods per control period",
    "SW_DEADTIME_NS": "dead time, ns",
    "F1": "scale of the observed current",
    "F2": "scale of the observed back-EMF",
    "GAIN1": "observer: error of the current to the current",
    "GAIN2": "observer: error of the current to the back-EMF",
    "PLL_KP_GAIN": "loop behind the observer, proportional",
    "PLL_KI_GAIN": "loop behind the observer, integral",
    "PLL_KPDIV": "",
    "PLL_KIDIV": "",
    "STO_FIFO_DEPTH_DPP": "periods over which the observer averages the speed",
    "STO_FIFO_DEPTH_UNIT": "periods over which the speed is averaged",
    "OBS_MINIMUM_SPEED_RPM": "least speed at which the observer is relied on, rpm",
    "PID_TORQUE_KP_DEFAULT": "q current, proportional",
    "PID_TORQUE_KI_DEFAULT": "q current, integral per period",
    "PID_FLUX_KP_DEFAULT": "d current, proportional",
    "PID_FLUX_KI_DEFAULT": "d current, integral per period",
    "TF_KPDIV": "",
    "TF_KIDIV": "",
    "SPEED_LOOP_FREQUENCY_HZ": "rate of the speed controller, Hz",
    "PID_SPEED_KP_DEFAULT": "counts of q current per 0.1 Hz",
    "PID_SPEED_KI_DEFAULT": "the same, integral per period",
    "SP_KPDIV": "",
    "SP_KIDIV": "",
    "IQMAX_A": "largest q current, A",
}

TABLE = {
    "SEGDIV": "counts of q current per segment",
    "ANGC": "slopes of the segments, 1/32768",
    "OFST": "offsets of the segments, counts of d current",
}

# Dividers whose logarithm stands in a macro of its own.
LOGARITHMS = (
    "PLL_KPDIV",
    "PLL_KIDIV",
    "TF_KPDIV",
    "TF_KIDIV",
    "SP_KPDIV",
    "SP_KIDIV",
    "F1",
    "F2",
    "STO_FIFO_DEPTH_DPP",
)

# Currents in A, and the macros that hold them in counts up to version 6.1.
COUNTED = {"NOMINAL_CURRENT_A": "NOMINAL_CURRENT", "ID_DEMAG_A": "ID_DEMAG", "IQMAX_A": "IQMAX"}

# Other names that versions give a macro.
OTHERWISE = {
    "ANGC": "M1_ANGC",
    "MAX_APPLICATION_SPEED_RPM": "MAX_APPLICATION_SPEED",
    "OBS_MINIMUM_SPEED_RPM": "OBS_MINIMUM_SPEED",
    "CONSTANT1_Q": "M1_CONSTANT1_Q",
    "CONSTANT1_D": "M1_CONSTANT1_D",
    "CONSTANT2_QD": "M1_CONSTANT2_QD",
}

# Written over (SPEED_UNIT/10), which is one where speeds are counted in tenths of a hertz.
SPEED_GAINS = ("PID_SPEED_KP_DEFAULT", "PID_SPEED_KI_DEFAULT")

# Read where they are there, and never written.
READ_ONLY = (
    "VBUS_PARTITIONING_FACTOR",
    "REV_PARK_ANGLE_COMPENSATION_FACTOR",
    "ENC_AVERAGING_FIFO_DEPTH",
    "HALL_AVERAGING_FIFO_DEPTH",
    "CONSTANT1_Q",
    "CONSTANT1_D",
    "CONSTANT2_QD",
    "FW_VOLTAGE_REF",
)

# Keys of the motor file (JSON) and what they are here; ``inertia`` in 1e-6 kg m^2, ``friction`` in
# 1e-6 N m s/rad.
MOTOR_FILE = {
    "polePairs": "POLE_PAIR_NUM",
    "rs": "RS",
    "ls": "LS",
    "BEmfConstant": "MOTOR_VOLTAGE_CONSTANT",
    "maxRatedSpeed": "MOTOR_MAX_SPEED_RPM",
    "nominalCurrent": "NOMINAL_CURRENT_A",
    "nominalDCVoltage": "NOMINAL_BUS_VOLTAGE_V",
    "inertia": "inertia",
    "friction": "friction",
}

HEADERS = MOTOR | STAGE | DRIVE | TABLE

WHOLE = frozenset(
    name
    for name in DRIVE
    if name not in ("IQMAX_A", "PWM_FREQUENCY", "SW_DEADTIME_NS", "SPEED_LOOP_FREQUENCY_HZ")
) | {"POLE_PAIR_NUM", "SEGDIV"}


# The table of currents of ST's MCSDK: eight segments of integers, fitted with the least largest
# error that they can have.
#
# The firmware works out i_d = ((ANGC[s] |i_q|) >> 15) + OFST[s] with s = min(|i_q| / SEGDIV, 7).

SEGMENTS = 8
_SLOPE = 32768.0  # ANGC of the slope one.
_STEEPEST = 65535  # Largest slope whose product with a current of 16 bits fits 32 bits.
_BLOCK = 64  # Slopes that are tried at once.
_WIDTHS = 25  # Widths of the segments that are compared in real numbers.

# Counts by which the best integers can be better than the best real numbers: the shift cuts off
# less than one count, which the offset halves.
_CLOSE = 0.5
Counts = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class MtpaTable:
    """Integers of the table; ``error`` is the largest deviation of i_d in counts over all currents
    from 0 to ``largest``, found by trying every one, and ``jump`` the largest step between two
    neighbouring currents at the joints.
    """

    width: int
    slopes: tuple[int, ...]
    offsets: tuple[int, ...]
    largest: int
    error: float
    jump: int

    def currents(self, i_q: Counts) -> Counts:
        """Counts of i_d that the firmware works out for counts of i_q."""
        return table_currents(self.width, self.slopes, self.offsets, i_q)


def table_currents(
    width: int, slopes: tuple[int, ...], offsets: tuple[int, ...], i_q: Counts
) -> Counts:
    """Counts of i_d by the firmware's arithmetic.

    Args:
        width, slopes, offsets: SEGDIV, ANGC and OFST.
        i_q: Counts, shape (N,).
    """
    size = np.abs(i_q)
    segment = np.minimum(size // width, SEGMENTS - 1)
    found: Counts = (np.asarray(slopes)[segment] * size >> 15) + np.asarray(offsets)[segment]
    return found


def fitted_table(wanted: FloatArray) -> MtpaTable:
    """The table with the least largest error.

    Args:
        wanted: Optimal i_d in counts for every count of i_q from 0 on, shape (N,).
    """
    largest = wanted.size - 1
    width = _best_width(wanted)
    best: MtpaTable | None = None
    for near in (width, width + 1, width - 1):
        table = _with_width(wanted, max(1, near))
        if table.largest == largest and (best is None or table.error < best.error):
            best = table
    assert best is not None
    return best


def _with_width(wanted: FloatArray, width: int) -> MtpaTable:
    slopes: list[int] = []
    offsets: list[int] = []
    for start, end in _segments(wanted.size, width):
        if start >= end:
            slopes.append(slopes[-1])
            offsets.append(offsets[-1])
            continue
        slope, offset = _best_line(np.arange(start, end), wanted[start:end])
        slopes.append(slope)
        offsets.append(offset)
    return measured_table(width, tuple(slopes), tuple(offsets), wanted)


def measured_table(
    width: int, slopes: tuple[int, ...], offsets: tuple[int, ...], wanted: FloatArray
) -> MtpaTable:
    """A table with its errors against wanted currents, as `fitted_table` is given them."""
    found = table_currents(width, slopes, offsets, np.arange(wanted.size))
    joints = np.arange(1, SEGMENTS) * width
    joints = joints[joints < wanted.size]
    jump = int(np.max(np.abs(found[joints] - found[joints - 1]), initial=0))
    error = float(np.max(np.abs(found - wanted)))
    return MtpaTable(width, slopes, offsets, wanted.size - 1, error, jump)


def best_linear_machine(table: MtpaTable) -> MtpaTable:
    """The table measured against the machine of constant inductances that it fits best.

    Its currents of least loss are i_d = s - sqrt(s^2 + i_q^2), with s = psi/(2 (L_q - L_d)).
    """
    i_q = np.arange(table.largest + 1.0)
    low, high = np.log(0.01 * table.largest + 1.0), np.log(100.0 * table.largest + 1.0)

    def against(logarithm: float) -> MtpaTable:
        scale = np.exp(logarithm)
        wanted = -i_q * i_q / (scale + np.sqrt(scale * scale + i_q * i_q))
        return measured_table(table.width, table.slopes, table.offsets, wanted)

    best = low
    for _ in range(4):
        tried = np.linspace(low, high, 41)
        errors = [against(float(one)).error for one in tried]
        place = int(np.argmin(errors))
        best = tried[place]
        low, high = tried[max(place - 1, 0)], tried[min(place + 1, 40)]
    return against(float(best))


def _segments(size: int, width: int) -> list[tuple[int, int]]:
    edges = [min(segment * width, size) for segment in range(SEGMENTS)]
    return list(zip(edges, [*edges[1:], size], strict=True))


def _best_width(wanted: FloatArray) -> int:
    """Width of the segments whose largest error in real numbers is least: the last segment may be
    longer than the others, where the curve is straight.
    """
    size = wanted.size
    widest = -(-size // SEGMENTS)
    low, high = max(1, widest // 3), widest
    while True:
        widths = np.unique(np.linspace(low, high, _WIDTHS).astype(int))
        errors = [_real_error(wanted, int(width)) for width in widths]
        # Ties go to the widest, so that currents beyond the last are least far from the table.
        best = len(errors) - 1 - int(np.argmin(errors[::-1]))
        if high - low < _WIDTHS:
            return int(widths[best])
        low = int(widths[max(best - 1, 0)])
        high = int(widths[min(best + 1, len(widths) - 1)])


def _real_error(wanted: FloatArray, width: int) -> float:
    """Largest deviation from a line of real numbers in any segment."""
    worst = 0.0
    for start, end in _segments(wanted.size, width):
        if end - start > 2:
            count = np.linspace(start, end - 1, min(end - start, 129)).astype(int)
            worst = max(worst, _best_real(count, wanted[count])[1])
    return worst


def _spread(i_q: Counts, wanted: FloatArray, slope: float) -> float:
    rest = slope * i_q - wanted
    return 0.5 * float(np.max(rest) - np.min(rest))


def _best_real(i_q: Counts, wanted: FloatArray) -> tuple[float, float]:
    """Slope and largest error of the best line in real numbers: half the spread is convex in the
    slope.
    """
    steps = np.diff(wanted) / np.diff(i_q)
    low, high = float(np.min(steps)), float(np.max(steps))
    for _ in range(40):
        first, second = low + (high - low) / 3.0, high - (high - low) / 3.0
        if _spread(i_q, wanted, first) <= _spread(i_q, wanted, second):
            high = second
        else:
            low = first
    slope = 0.5 * (low + high)
    return slope, _spread(i_q, wanted, slope)


def _best_line(i_q: Counts, wanted: FloatArray) -> tuple[int, int]:
    """Slope and offset with the least largest error in the firmware's arithmetic.

    Slopes are tried outwards from the best real one for as long as the error in real numbers, which
    rises to both sides, leaves room for a better one.
    """
    if i_q.size < 3:
        return _whole_line(i_q, wanted)
    slope, _ = _best_real(i_q, wanted)
    centre = round(slope * _SLOPE)
    best = (np.inf, 0, 0, 0)
    for side in (1, -1):
        first = centre if side == 1 else centre - 1
        while True:
            candidates = first + side * np.arange(_BLOCK)
            candidates = candidates[np.abs(candidates) <= _STEEPEST]
            best = min(best, _tried(i_q, wanted, candidates, centre))
            first += side * _BLOCK
            if abs(first) > _STEEPEST or _spread(i_q, wanted, first / _SLOPE) > best[0] + _CLOSE:
                break
    return best[2], best[3]


def _tried(
    i_q: Counts, wanted: FloatArray, slopes: Counts, centre: int
) -> tuple[float, int, int, int]:
    """Least largest error of slopes, shape (K,), with their best offsets; of equal ones that next
    to the centre. Then how far it is from there, slope and offset.
    """
    if slopes.size == 0:
        return np.inf, 0, 0, 0
    rest = (slopes[:, np.newaxis] * i_q >> 15) - wanted
    top, bottom = np.max(rest, axis=1), np.min(rest, axis=1)
    offsets = np.rint(-0.5 * (top + bottom))
    errors = np.maximum(np.abs(top + offsets), np.abs(bottom + offsets))
    away = np.abs(slopes - centre)
    best = int(np.lexsort((away, errors))[0])
    return float(errors[best]), int(away[best]), int(slopes[best]), int(offsets[best])


def _whole_line(i_q: Counts, wanted: FloatArray) -> tuple[int, int]:
    slope = 0.0 if i_q.size < 2 else float(wanted[1] - wanted[0])
    whole = round(slope * _SLOPE)
    return whole, round(float(wanted[0])) - (whole * int(i_q[0]) >> 15)


def locus_counts(i_d: FloatArray, i_q: FloatArray, full_current: float) -> FloatArray:
    """Optimal i_d in counts for every count of i_q.

    Args:
        i_d, i_q: Points of the locus in A, ascending in i_q, shape (L,).
        full_current: A of 32768 counts.
    """
    from scipy.interpolate import PchipInterpolator

    rising = np.concatenate(([True], np.diff(np.maximum.accumulate(i_q)) > 0.0))
    curve = PchipInterpolator(i_q[rising], i_d[rising])
    count = 32768.0 / full_current
    largest = int(np.floor(i_q[rising][-1] * count))
    counts = np.arange(largest + 1, dtype=np.float64)
    return np.asarray(curve(counts / count)) * count
