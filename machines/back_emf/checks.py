"""What makes an oscilloscope capture of the back-EMF unfit, and what its user should know.

The refusals raise `InputError` with the file and the line where the trouble begins.
The findings are sentences.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.machines.back_emf.harmonics import HarmonicFit, resolution
from dqforge.machines.errors import InputError
from dqforge.machines.files.text_table import TextTable
from dqforge.machines.records import dataclass
from dqforge.machines.units.quantities import format_quantity, parse_quantity
from dqforge.machines.units.registry import COMPOUNDS, DIMENSIONS, SYMBOLS

# No three windings of one machine differ as much as this; probes set to 1 and 10 do.
_LEAST_SAMPLES = 16
_LEAST_EXPLAINED = 0.8
_DEAD_EXPLAINED = 0.5
_PROBE_RATIO = 3.0
_DISPLACEMENT = np.radians(20.0)
_CONTRADICTION = 0.05
_RUN = 6
_LEAST_CLIPPED = 0.005


@dataclass(frozen=True, slots=True)
class Origin:
    """Where samples come from: file name and the line of each sample, shape (N,)."""

    source: str
    lines: NDArray[np.intp]

    def error(self, message: str, sample: int | None = 0) -> InputError:
        """Return the error for the user at a sample, or about the file as a whole."""
        line = None if sample is None or not self.lines.size else int(self.lines[sample])
        return InputError(message, source=self.source, line=line)


def check_samples(
    time: FloatArray | None, angle: FloatArray | None, voltages: FloatArray, origin: Origin
) -> FloatArray:
    """Refuse shapes that do not fit, too few samples, values that are not finite and
    time that does not ascend.

    The time or angle, whichever is given, is returned.
    """
    axis = time if time is not None else angle
    if axis is None or (time is not None and angle is not None):
        raise origin.error("a capture has either times or angles", None)
    if (
        axis.ndim != 1
        or voltages.ndim != 2
        or voltages.shape[1] != axis.size
        or origin.lines.shape != axis.shape
    ):
        shapes = f"{axis.shape}, {voltages.shape} and {origin.lines.shape}"
        raise origin.error(
            f"a capture needs as many samples as times and lines, got the shapes {shapes}", None
        )
    if axis.size < _LEAST_SAMPLES:
        raise origin.error(
            f"{axis.size} samples are too few; a period needs at least {_LEAST_SAMPLES}", None
        )
    for name, values in (
        ("time" if time is not None else "angle", axis[None]),
        ("voltage", voltages),
    ):
        wrong = np.flatnonzero(~np.all(np.isfinite(values), axis=0))
        if wrong.size:
            raise origin.error(
                f"a {name} is missing or not finite; give a number or leave the line out",
                int(wrong[0]),
            )
    if time is not None:
        back = np.flatnonzero(np.diff(time) <= 0.0)
        if back.size:
            here = int(back[0]) + 1
            what = (
                "equals the time before"
                if time[here] == time[here - 1]
                else "is before the time of the last line"
            )
            raise origin.error(
                f"the time {time[here]:.9g} s {what}; times must ascend and be written with all "
                "their digits",
                here,
            )
    return axis


def check_flat(voltages: FloatArray, origin: Origin) -> None:
    """Refuse channels, shape (K, N), that never change."""
    for channel, values in enumerate(voltages, start=1):
        if np.ptp(values) == 0.0:
            raise origin.error(
                f"channel {channel} is dead: it stays at {values[0]:g} V; connect its probe, or "
                "choose other columns"
            )


def check_line(share: float, origin: Origin) -> None:
    """Refuse captures without a frequency that stands out; ``share`` is that of its power."""
    if share < 0.3:
        raise origin.error(
            f"the capture is not periodic: no frequency stands out, the strongest has {share:.0%} "
            "of the power; give a part where the machine turns steadily and the inverter is off"
        )


def check_length(periods: float, samples: float, origin: Origin) -> None:
    """Refuse captures of less than one electrical period, or with less than 8
    ``samples`` to the period.
    """
    if periods < 0.98:
        raise origin.error(
            f"the capture holds about {periods:.2f} electrical periods; at least 1 is needed, 5 or "
            "more are better"
        )
    if samples < 8.0:
        raise origin.error(
            f"the capture has about {samples:.1f} samples in an electrical period, so that it may "
            "show another frequency than the machine's; at least 8 are needed: sample faster or "
            "turn the machine more slowly"
        )


def check_clipping(voltages: FloatArray, samples: float, origin: Origin) -> list[str]:
    """Refuse channels, shape (K, N), that stand at an extreme value for longer than noise permits.

    A trapezoid is flat, too, but its noise moves the samples of the top. Without noise to tell the
    two apart there is a finding instead. ``samples`` is the number of samples to the period.
    """
    findings = []
    for channel, values in enumerate(voltages, start=1):
        step, size = resolution(values), float(np.ptp(values))
        # The top of a sine stands at one level for as long as it falls by less than a step.
        natural = samples / np.pi * np.arccos(1.0 - min(2.0 * step / size, 1.0))
        for level in (float(np.max(values)), float(np.min(values))):
            stands = values == level
            edges = np.flatnonzero(
                np.diff(np.concatenate([[False], stands, [False]]).astype(np.int8))
            )
            runs = edges[1::2] - edges[::2]
            if (
                np.max(runs) < max(_RUN, samples / 50.0, 1.5 * natural)
                or np.mean(stands) < _LEAST_CLIPPED
            ):
                continue
            text = (
                f"{np.count_nonzero(stands)} samples ({np.mean(stands):.1%}) of channel {channel} "
                f"stand at {level:g} V"
            )
            if _noise_between(values) < max(0.7 * step, 1e-5 * size):
                findings.append(
                    f"{text}; make sure that the range of the oscilloscope was not exceeded."
                )
                continue
            longest = int(edges[2 * int(np.argmax(runs >= _RUN))])
            raise origin.error(
                f"{text}: clipped; capture again with a larger range (more volts per division)",
                longest,
            )
    return findings


def _noise_between(values: FloatArray) -> float:
    """Noise of samples, shape (N,), that lie between the extremes, from their second differences.

    The median ignores edges and glitches; rounding without noise gives at most 0.6 steps.
    """
    inner = (values > np.min(values)) & (values < np.max(values))
    seconds = np.abs(np.diff(values, 2))[inner[:-2] & inner[1:-1] & inner[2:]]
    return 1.4826 / np.sqrt(6.0) * float(np.median(seconds)) if seconds.size else 0.0


def check_periodic(fit: HarmonicFit, voltages: FloatArray, samples: float, origin: Origin) -> None:
    """Refuse channels, shape (K, N), that a machine turning at a steady or
    drifting speed does not explain.
    """
    if np.min(fit.motion.rate()) <= 0.0:
        raise origin.error(
            "the machine stops or turns back within the capture; give a part where it turns one way"
        )
    best = float(np.max(fit.explained))
    block = min(int(samples), fit.residual.shape[1])
    whole = fit.residual.shape[1] // block * block
    blocks = fit.residual[:, :whole].reshape(fit.residual.shape[0], -1, block)
    left = np.einsum("kbn,kbn->kb", blocks, blocks, dtype=np.float64) / block
    departs = left > (1.0 - _LEAST_EXPLAINED) * np.array([[np.var(row)] for row in voltages])
    first = np.argmax(departs, axis=1) * block
    for channel, share in enumerate(fit.explained):
        if share < _DEAD_EXPLAINED and best >= _LEAST_EXPLAINED:
            raise origin.error(
                f"channel {channel + 1} is dead or comes loose: only {max(share, 0.0):.0%} of it "
                "has the period of the others, the rest is noise; connect its probe, or choose "
                "other columns",
                int(first[channel]),
            )
    worst = int(np.argmin(fit.explained))
    if fit.explained[worst] < _LEAST_EXPLAINED:
        raise origin.error(
            f"the capture is not periodic: harmonics of {fit.motion.frequency:.4g} Hz explain "
            f"{max(float(fit.explained[worst]), 0.0):.0%} of channel {worst + 1}, less than "
            f"{_LEAST_EXPLAINED:.0%}; give a part where the machine turns steadily and the "
            "inverter is off",
            int(first[worst]),
        )
    if np.any(departs):
        channel = int(np.argmax(np.any(departs, axis=1)))
        raise origin.error(
            f"channel {channel + 1} departs here from the period of the rest (harmonics of "
            f"{fit.motion.frequency:.4g} Hz); give a part without disturbance, where the machine "
            "turns steadily",
            int(first[channel]),
        )


def check_ratios(fundamentals: NDArray[np.complex128], origin: Origin) -> None:
    """Refuse two or three channels of which one is larger or smaller by a factor,
    as by the setting of its probe.
    """
    sizes = np.abs(fundamentals)
    # Of two that differ nobody can say which is wrong.
    for channel, size in enumerate(sizes) if sizes.size == 3 else ():
        others = float(np.mean(np.delete(sizes, channel)))
        ratio = max(size / others, others / size)
        alike = np.ptp(np.delete(sizes, channel)) < 0.5 * others
        if ratio < _PROBE_RATIO or not alike:
            continue
        word = "less" if size < others else "more"
        scale = ["1", "1", "1"]
        scale[channel] = f"{_round_ratio(others / float(size)):g}"
        raise origin.error(
            f"channel {channel + 1} reads {ratio:.1f} times {word} than the others; "
            f"probe setting? if so, write "
            f"--scale {','.join(scale)}, in a design scale: [{', '.join(scale)}]"
        )
    if np.max(sizes) > _PROBE_RATIO * np.min(sizes):
        text = ", ".join(f"{size / np.max(sizes):.3g}" for size in sizes)
        raise origin.error(
            f"the channels' fundamentals are as {text}; check the probes' settings and "
            "write --scale A,B,C, in a design scale: [A, B, C]"
        )


def _round_ratio(factor: float) -> float:
    """Factor as a probe may have it (1, 2 or 5 times a power of ten) when within 5 % of one."""
    decade = 10.0 ** np.floor(np.log10(factor))
    likely = decade * np.array([1.0, 2.0, 5.0, 10.0])
    nearest = float(likely[np.argmin(np.abs(likely - factor))])
    return nearest if abs(nearest - factor) < 0.05 * factor else float(f"{factor:.3g}")


def check_displacements(fundamentals: NDArray[np.complex128], origin: Origin) -> None:
    """Refuse two or three channels that are not 120 degrees apart, in either sequence."""
    lags = np.angle(fundamentals[0] / fundamentals[1:])
    wanted = (2.0 * np.pi / 3.0) * np.arange(1, fundamentals.size)
    if (
        min(np.max(np.abs(np.angle(np.exp(1j * (lags - sign * wanted))))) for sign in (1.0, -1.0))
        < _DISPLACEMENT
    ):
        return
    degrees = [float(lag) for lag in np.degrees(lags) % 360.0]
    found = [
        f"channel {channel} is {lag:.0f} degrees" for channel, lag in enumerate(degrees, start=2)
    ]
    raise origin.error(
        f"{' and '.join(found)} behind channel 1; three phases are 120 and 240 degrees behind (or "
        f"240 and 120){_displacement_hint(degrees)}"
    )


def _displacement_hint(degrees: list[float]) -> str:
    """What may be the reason, from how far the second and third channel are behind the first."""
    pairs = [("1 and 2", degrees[0])]
    pairs += [
        pair
        for third in degrees[1:]
        for pair in (("1 and 3", third), ("2 and 3", third - degrees[0]))
    ]
    same = [name for name, lag in pairs if min(lag % 360.0, -lag % 360.0) < 10.0]
    if same:
        return f"; channels {same[0]} show the same voltage"
    if any(abs(min(lag % 360.0, -lag % 360.0) - 60.0) < 15.0 for _, lag in pairs):
        return "; a probe is connected the wrong way round (give it a negative scale)"
    return "; check what the probes were connected to"


def check_speed(
    frequency: float, pole_pairs: int | None, speed: float | None, origin: Origin
) -> None:
    """Refuse a stated speed in rad/s that contradicts the measured electrical frequency in Hz."""
    if pole_pairs is None or speed is None:
        return
    stated = pole_pairs * abs(speed) / (2.0 * np.pi)
    if abs(stated - frequency) > _CONTRADICTION * frequency:
        implied = 2.0 * np.pi * frequency / pole_pairs
        pairs = 2.0 * np.pi * frequency / max(abs(speed), 1e-300)
        raise origin.error(
            f"{format_quantity(abs(speed), 'rpm')} and {pole_pairs} pole pairs make {stated:.4g} "
            f"Hz, but the capture has {frequency:.4g} Hz, i.e. {format_quantity(implied, 'rpm')} "
            f"or {pairs:.2f} pole pairs; correct one of them",
            None,
        )


def check_coverage(gap: float, origin: Origin) -> None:
    """Refuse angles that leave more than an eighth of the electrical period without a sample.

    ``gap`` in rad.
    """
    if gap > np.pi / 4.0 * (1.0 + 1e-9):
        raise origin.error(
            f"the angles leave {np.degrees(gap):.0f} degrees of the electrical period without a "
            "sample; they must cover a whole period in steps of 45 degrees at most"
        )


def check_condition(fit: HarmonicFit, origin: Origin) -> None:
    """Refuse samples that lie so unevenly that they do not tell the harmonics apart."""
    if fit.condition > 1e8:
        raise origin.error(
            f"the samples lie too unevenly to tell {fit.coefficients.shape[1]} harmonics apart; "
            "request fewer harmonics"
        )


def check_certain(amplitudes: FloatArray, uncertainty: FloatArray, origin: Origin) -> list[str]:
    """Refuse fundamentals that are no larger than their uncertainty, shapes (3,);
    a finding above a fifth of them.
    """
    worst = float(np.max(uncertainty / np.maximum(amplitudes, 1e-300)))
    if worst >= 1.0:
        raise origin.error(
            "the fundamental is less than its uncertainty; capture more periods, or with less noise"
        )
    if worst > 0.2:
        return [
            (
                f"The fundamental is uncertain by {worst:.0%}; capture more periods, or with less "
                "noise."
            )
        ]
    return []


# What the samples of a capture lie over: a column of times or angles,
# or an interval that the heading states.

AxisKind = Literal["time", "angle", "count", "none"]

_WORDS = {
    "v": "V",
    "volt": "V",
    "volts": "V",
    "sec": "s",
    "second": "s",
    "seconds": "s",
    "degree": "deg",
} | {
    "degrees": "deg",
    "s": "s",
    "v*s": "Vs",
    "v s": "Vs",
}

UNIT_KINDS: dict[str, frozenset[str]] = {
    "time": frozenset(symbol for symbol, name in SYMBOLS.items() if name.endswith("second")),
    "angle": frozenset(
        symbol for symbol, name in SYMBOLS.items() if name.endswith(("radian", "degree"))
    ),
    "voltage": frozenset(symbol for symbol, name in SYMBOLS.items() if name.endswith("volt")),
    "flux": frozenset(symbol for symbol, name in SYMBOLS.items() if name.endswith("weber"))
    | frozenset(symbol for symbol, names in COMPOUNDS.items() if names[0].endswith("volt")),
}

# How the heading of a column without unit begins that is an angle instead of a time, or a flux
# linkage.
_NAMES_OF_SECOND_KIND = {"angle": "theta|angle|phi|winkel", "flux": "psi|flux|lambda"}

_TIME_NAME = re.compile(
    r"t|time\b.*|zeit\b.*|temps\b.*|tiempo\b.*|x[- ]?axis|seconds?|timestamp", re.IGNORECASE
)

_CHANNEL_NAME = re.compile(
    r"(ch|chan|channel|kanal|voie|canal|trace)[ _]?[0-9a-d]+v?", re.IGNORECASE
)

_COUNT_NAME = re.compile(r"sequence|samples?|index|point|nr\.?|no\.?|#", re.IGNORECASE)
_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"

_INTERVAL = re.compile(
    r"\W*(?:(?:x ?inc(?:rement)?|t ?inc(?:rement)?|increment|h ?resolution|resolution|dt|delta "
    r"?[tx]|t ?interval)\b|(?:sampl(?:e|ing) ?|time )(?:interval|period)\b)(.*)",
    re.IGNORECASE | re.DOTALL,
)

_RATE = re.compile(r"\W*(?:sampl(?:e|ing) ?(?:rate|frequency))\b(.*)", re.IGNORECASE | re.DOTALL)
# The whole word behind the number is its unit: of "500 kSa/s" nothing counts without it.
_STATED = re.compile(rf"(?<![\w.+-])({_NUMBER})(?>\s*(\w*(?:/\w+)?))(?=$|[\s,;:\"'])")

_RATE_UNITS = {
    "": 1.0,
    "Hz": 1.0,
    "kHz": 1e3,
    "MHz": 1e6,
    "GHz": 1e9,
    "samples": 1.0,
} | {
    f"{prefix}{sample}": size
    for prefix, size in (("", 1.0), ("k", 1e3), ("M", 1e6), ("G", 1e9))
    for sample in ("S", "Sa")
}
_PER_SECOND = ("", "s", "sec", "second")

# Share of falling steps from which on a column is no time: a voltage falls in half of its steps.
_FALLS = 0.25


@dataclass(frozen=True, slots=True)
class Axis:
    """What the samples of a table lie over.

    Args:
        kind: ``time`` or ``angle``.
        values: In s or rad (as the column has it, of the electrical or mechanical angle), shape
            (N,).
        column: Place of the column among those of the table; None where times come from an
            interval.
        ignored: Place of a column that counts the samples, None where there is none.
    """

    kind: Literal["time", "angle"]
    values: FloatArray
    column: int | None
    ignored: int | None = None


def kind_and_unit(table: TextTable, column: int) -> tuple[str, str]:
    """Kind of a column by its unit, empty if unknown, and the unit's symbol."""
    unit = symbol(table.units[column])
    return next((kind for kind, symbols in UNIT_KINDS.items() if unit in symbols), ""), unit


def symbol(unit: str) -> str:
    """Symbol of a unit that may be written as a word, as some oscilloscopes do."""
    unit = unit.strip()
    return unit if unit in SYMBOLS or unit in COMPOUNDS else _WORDS.get(unit.casefold(), unit)


def factor(
    table: TextTable, column: int, given: str | None, wanted: tuple[str, str], origin: Origin
) -> tuple[str, float]:
    """Which of the wanted kinds a column is, and the factor to SI units."""
    kind, unit = kind_and_unit(table, column)
    if given is not None:
        unit = symbol(given)
        kind = next((name for name in wanted if unit in UNIT_KINDS[name]), "")
    if kind in wanted:
        return kind, 1.0 if unit == DIMENSIONS[kind].unit else parse_quantity(f"1 {unit}", kind)
    if unit:
        examples = " or ".join(DIMENSIONS[name].unit for name in wanted)
        raise origin.error(
            f"{table.names[column]} has the unit {unit!r}, expected e.g. {examples}", 0
        )
    named = re.match(_NAMES_OF_SECOND_KIND[wanted[1]], table.names[column], re.IGNORECASE)
    return wanted[1] if named else wanted[0], 1.0


def find_axis(
    table: TextTable,
    column: int | None,
    time_unit: str | None,
    interval: float | None,
    origin: Origin,
) -> Axis:
    """Times or angles of a table's samples.

    Args:
        table: The file.
        column: Place of the column that the user calls the axis, None where it is to be found: only
            the first can be one.
        time_unit: Unit of that column, where the user gave one.
        interval: Time between two samples in s that the user gave, or None.
        origin: Where the samples come from.

    Raises:
        InputError: Nothing tells the times, or two things tell them differently.
    """
    kind: AxisKind = "time"
    if column is None:
        column = 0
        kind = "time" if time_unit is not None else _kind_of_first(table)
    if kind in ("time", "angle"):
        if interval is not None:
            title = table.names[column]
            raise origin.error(f"the file has {kind}s already ('{title}'); omit the interval", None)
        found, scale = factor(table, column, time_unit, ("time", "angle"), origin)
        return Axis(
            "angle" if found == "angle" else "time", table.values[:, column] * scale, column
        )
    stated = _stated_interval(table.preamble, origin)
    if interval is not None and stated is not None and abs(interval - stated) > 1e-3 * stated:
        given = format_quantity(interval, "s")
        raise origin.error(
            f"the interval is {given}, but the file states {format_quantity(stated, 's')}", None
        )
    step = interval if interval is not None else stated
    if step is None:
        raise origin.error(_without_time(table, kind), None)
    ignored = 0 if kind == "count" else None
    counts = table.values[:, 0] if kind == "count" else np.arange(float(table.values.shape[0]))
    return Axis("time", counts * step, None, ignored)


def _kind_of_first(table: TextTable) -> AxisKind:
    """What the first column is: by its heading, its unit, or how its numbers run."""
    name, values = table.names[0], table.values[:, 0]
    kind, unit = kind_and_unit(table, 0)
    if _CHANNEL_NAME.fullmatch(name) or kind in ("voltage", "flux"):
        return "none"
    if unit.casefold() == "sequence" or _COUNT_NAME.fullmatch(name):
        return "count"
    if kind == "angle" or (
        not unit and re.match(_NAMES_OF_SECOND_KIND["angle"], name, re.IGNORECASE)
    ):
        return "angle"
    steps = np.diff(values)
    if _TIME_NAME.fullmatch(name):
        return "time"
    if np.count_nonzero(steps < 0.0) > _FALLS * steps.size:
        return "none" if not unit or kind == "time" else "time"
    return "count" if not unit and np.all(steps == 1.0) else "time"


def _without_time(table: TextTable, kind: AxisKind) -> str:
    """What to say of a table without times."""
    first = table.names[0]
    what = f"'{first}' counts the samples" if kind == "count" else f"'{first}' looks like a channel"
    return (
        f"the file has no column of times and states no interval ({what}); write the time between "
        "two samples: --interval 2 us, in a design interval: 2 us"
    )


def _stated_interval(preamble: Sequence[str], origin: Origin) -> float | None:
    """Time between two samples in s by the lines above or beside the rows,
    None where they say nothing.
    """
    for pattern, is_rate in ((_INTERVAL, False), (_RATE, True)):
        found = {
            value for line in preamble if (value := _stated_in(line, pattern, is_rate)) is not None
        }
        if found:
            if max(found) > 1.001 * min(found):
                texts = " and ".join(format_quantity(value, "s") for value in sorted(found)[:2])
                raise origin.error(
                    f"the file states several sample intervals, {texts}; save the channels alone",
                    None,
                )
            return min(found)
    return None


def _stated_in(line: str, pattern: re.Pattern[str], is_rate: bool) -> float | None:
    """Interval in s that a line states, None where it states none."""
    named = pattern.match(line)
    if named is None:
        return None
    text = named[1]
    if "," in text and "." not in text and re.search(r"[;\t:=]\s*[-+]?\d+,\d", text):
        text = text.replace(",", ".")
    found = set()
    for match in _STATED.finditer(text):
        number = float(match[1])
        unit, _, per = match[2].partition("/")
        if is_rate:
            scale = _RATE_UNITS.get(unit) if per in _PER_SECOND else None
        else:
            scale = _time_scale(match[2])
        if scale is not None and number > 0.0:
            found.add(1.0 / (number * scale) if is_rate else number * scale)
    return found.pop() if len(found) == 1 else None


def _time_scale(unit: str) -> float | None:
    """Seconds of a unit of time, 1 without one, None of another unit."""
    unit = symbol(unit)
    if not unit:
        return 1.0
    return parse_quantity(f"1 {unit}", "time") if unit in UNIT_KINDS["time"] else None
