"""Drives without encoder, drawn at random, by the emitted C at random points of their tolerances:
each keeps what is promised of it, or is refused beforehand.

``python tests/benchmarks/sensorless_samples.py --method flux --drives 60 --points 100 --seed 1``
prints a line per drive and the rows of the table that docs/methods/observed-loops.md has;
``--rows FILE`` writes all of it as JSON, with the design of every drive that failed, and
``--keep FILE...`` puts the rows of such files in place of those of their methods in the tree.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from unittest.mock import patch

import numpy as np

from dqforge.machines.design.catalogue import load_text
from dqforge.machines.design.design import Design
from dqforge.machines.dq_machines.synchronous import linearised
from dqforge.machines.errors import NoSolutionError
from dqforge.machines.names import ObserverMethodName
from dqforge.machines.plants.scenario import PlantErrors, Profile, Scenario, Sensorless
from dqforge.optimizer.control_design import observed_remedies
from dqforge.optimizer.control_design.design_drive import observed_drive, position_estimator
from dqforge.optimizer.control_design.drive_model import drive_cases
from dqforge.optimizer.control_design.observed_remedies import require_observed
from dqforge.optimizer.control_design.speed_range import steady_drives
from dqforge.optimizer.loops.loop_gains import LoopGains
from dqforge.optimizer.loops.observed_margins import CornerJudgement
from dqforge.optimizer.solution import Solution, solve
from dqforge.reports.simulation.design_run import (
    angle_error,
    controller_files,
    drive_of,
    observers_of,
)
from dqforge.reports.simulation.recorded_run import Simulation, Simulator, simulate, simulator

KEPT = Path(__file__).parent / "sensorless_samples.json"
METHODS: tuple[ObserverMethodName, ...] = (
    "flux", "open-loop-flux", "extended-emf", "matsui-voltage", "matsui-current", "ekf",
)  # fmt: skip

# A swing counts above this share of the speed; the speed may be wrong by this more than is stated.
SWING, BESIDE = 0.01, 2e-3
# Crossover times that a run lasts, between a least and a largest time in s; where the speed still
# moves at its end it is run again for longer, so that what dies away slowly is no swing.
CROSSOVERS, SHORTEST, LONGEST, LONGER = 120.0, 0.5, 8.0, 5.0
ROWS = 3000  # recorded of a run

# Parts of a run: the load steps at the first share of it, what follows at the second one; each is
# judged over the last part of its time.
_FIRST, _SECOND, _LAST = 0.25, 0.6, 0.3
# Before that the drive comes from a speed a little lower, and passes from an encoder to its
# observer on the way: shares of its true speed, and of the time until the load steps.
_BEFORE, _AT, _RISE = 0.98, 0.99, 0.4
# A run-up begins at this multiple of the lowest speed; each `_GENTLE` crossover times it gains as
# much as the speed may step, or this share of the largest.
_LOW, _GENTLE, _SMALL = 1.5, 10.0, 0.01
# Dip of the speed under a load that rises slowly, as a share of it, and the most time in s that it
# takes.
_DIP, SLOWEST = 0.01, 60.0

YAML = """dqforge: 1
name: Drawn drive
machine:
  model: linear
  pole_pairs: {pole_pairs}
  resistance: {r_s:.4g} Ohm
  inductance_d: {l_d:.4g} H
  inductance_q: {l_q:.4g} H
  magnet_flux: {psi:.4g} Wb
  max_current: {i_max:.4g} A
  max_speed: {speed:.4g} rad/s
  inertia: {inertia:.4g} kg m^2
  friction: {friction:.4g} N m s
inverter:
  topology: three-wire
  v_dc: {v_dc:.4g} V
  switching_frequency: {carrier:.0f} Hz
  dead_time: 0 s
  max_current: {i_inverter:.4g} A
control:
  current_loop: {{method: magnitude-optimum}}
  speed_loop: {{method: symmetrical-optimum, ratio: {ratio}}}
  observer: {{method: {method}}}
operation: {{strategy: mtpa}}
fit: {{form: torque-exact, segments: 1}}
export: {{prefix: drawn, vectors: 16}}
"""


def drawn(generator: np.random.Generator, method: ObserverMethodName) -> str:
    """A design at random: 50 W to 30 kW, 24 to 750 V, 2 to 10 pole pairs, L_q/L_d of 1 to 2.5,
    5 to 20 kHz, 60 to 500 Hz; the loop is left to the rule, and no tolerances are named.
    """

    def between(low: float, high: float) -> float:
        return float(np.exp(generator.uniform(np.log(low), np.log(high))))

    power, carrier = between(50.0, 30e3), 100.0 * round(between(50.0, 200.0))
    links = (24.0, 60.0) if power < 300.0 else (48.0, 350.0) if power < 2e3 else (300.0, 750.0)
    v_dc, pole_pairs = between(*links), int(generator.integers(2, 11))
    omega = 2.0 * np.pi * between(60.0, min(500.0, carrier / 20.0))
    psi = between(0.55, 0.85) * v_dc / np.sqrt(3.0) / omega
    i_max = between(1.5, 3.0) * power / (1.5 * psi * omega)
    l_q = between(0.15, 0.5) * psi / i_max
    small = (
        power / 1e3
    ) ** -0.2  # the smaller a machine, the more of its voltage its winding takes
    torque, speed = 1.5 * pole_pairs * psi * i_max, omega / pole_pairs
    return YAML.format(
        method=method, pole_pairs=pole_pairs, v_dc=v_dc, carrier=carrier, psi=psi, i_max=i_max,
        i_inverter=2.0 * i_max, l_q=l_q, l_d=l_q / float(generator.uniform(1.0, 2.5)),
        r_s=between(0.01, 0.1) * small * psi * omega / i_max, speed=speed,
        inertia=torque * between(0.03, 0.5) / speed, friction=0.01 * torque / speed,
        ratio=int(generator.integers(5, 11)),
    )  # fmt: skip


def speed_gains(solved: Solution) -> tuple[LoopGains, CornerJudgement]:
    """The speed loop, and where it holds."""
    speed = solved.gains.speed
    assert speed is not None
    assert speed.observed is not None
    assert speed.observed.corners is not None
    return speed, speed.observed.corners


def accepted(design: Design) -> Solution | str:
    """What is solved of a design; what kind of refusal it meets where it is refused."""
    try:
        solved = solve(design)
        # what would hold instead is not asked for, and takes longer than all else
        with patch.object(observed_remedies, "remedies", return_value=()):
            require_observed(design, solved.gains)
    except NoSolutionError as error:
        return kind_of(error.message)
    return solved


KINDS = {
    "there is no speed at which it holds": "no speed",
    "does not hold at all corners": "not up to the top",
    "phase margin": "margin",
    "is unstable": "unstable",
}


def kind_of(message: str) -> str:
    """A refusal in two words; its beginning where it is of another kind."""
    return next((kind for words, kind in KINDS.items() if words in message), message[:90])


@dataclass(frozen=True)
class Course:
    """How long a run takes, and how it comes to its speed and load. ``time`` in s without the
    run-up, which takes ``climb`` in s from a share ``low`` of the speed on, and without ``slow`` in
    s, which a load that rises slowly takes beside.
    """

    time: float
    climb: float = 0.0
    low: float = 1.0
    slow: float = 0.0

    @property
    def duration(self) -> float:
        """In s, all included."""
        return self.time + self.climb + self.slow

    @property
    def instants(self) -> tuple[float, float]:
        """Times in s of both steps."""
        first, second = _FIRST * self.time + self.climb, _SECOND * self.time + self.climb
        return first, second + self.slow


@dataclass(frozen=True)
class Point:
    """A run. ``kind`` is ``load`` where the load comes and goes, ``speed`` where the speed steps
    under it, ``rest`` where it rises slowly to that of the corners; ``loads`` in N m before the
    first step, between both, and at the end. ``omega`` are electrical speeds in rad/s before and
    after the second step, as the observer tells them, ``true`` is the one that the first of them
    is.
    """

    kind: str
    errors: dict[str, float]
    omega: tuple[float, float]
    loads: tuple[float, float, float]
    true: float

    def scenario(self, course: Course, pole_pairs: int, taken: float | None) -> Scenario:
        """The run on the observer from the instant ``taken`` in s on, in which the drive passes
        a speed on an encoder that tells the truth; that drive alone where it is None.
        """
        first, second = course.instants
        rise, at_once = _RISE * _FIRST * course.time, 1e-6 * course.time
        before, after = (each / pole_pairs for each in self.omega)
        true = course.low * self.true / pole_pairs
        load = Profile(
            (0.0, first, second), self.loads, "linear" if self.kind == "rest" else "hold"
        )
        told = Profile((0.0, rise), (_BEFORE * true, true), "linear")
        if taken is not None:
            share = _BEFORE + (1.0 - _BEFORE) * min(taken / rise, 1.0)
            begun, rise = course.low * before, max(rise, taken) + 2.0 * at_once
            risen = rise + course.climb + at_once
            told = Profile(
                (0.0, taken, taken + at_once, rise, risen, second, second + at_once),
                (_BEFORE * true, share * true, share * begun, begun, before, before, after),
                "linear",
            )
        return Scenario(
            course.duration if taken is not None else 2.0 * rise, "speed", told, load=load,
            omega_m=_BEFORE * true, errors=PlantErrors(**self.errors), dead_time=0.0,
            sensorless=Sensorless(_AT * true, 0.0),
        )  # fmt: skip


def a_point(generator: np.random.Generator, found: CornerJudgement, place: int) -> Point:
    """Half of them meet a load that comes and goes, a quarter a step of load and one of speed, a
    quarter rest under the load of the corners; every second lies at a corner of the box.
    """
    steps, held = found.steps, found.binding
    assert steps is not None
    errors = {name: float(generator.uniform(*pair)) for name, pair in found.limits.items()}
    if place % 2:
        errors = {name: float(generator.choice(pair)) for name, pair in found.limits.items()}
    kind = ("load", "load", "speed", "rest")[place // 2 % 4] if steps.load > 0.0 else "rest"
    way, change = float(generator.choice([-1.0, 1.0])), 0.0
    low, high = steps.load_low, steps.load_high
    loads = (0.0, way * steps.load, 0.0)
    if kind == "speed":
        loads = (0.0, way * steps.load, way * steps.load)
        edge = steps.overshoot * steps.speed
        low, high = max(low, held.low + edge), min(high, held.high - edge)
        change = float(generator.choice([-1.0, 1.0])) * max(0.0, min(steps.speed, high - low))
        low, high = low - min(change, 0.0), max(high, low) - max(change, 0.0)
    elif kind == "rest":
        low, high = held.low, held.high
        loads = (0.0, 0.0, way * found.loads[1])
    omega = float(np.exp(generator.uniform(np.log(low), np.log(high))))
    return Point(kind, errors, (omega, omega + change), loads, omega)


def some_points(
    generator: np.random.Generator, solved: Solution, found: CornerJudgement, count: int
) -> list[Point]:
    """Points of a drive's box, with the true speeds that belong to those of the observer."""
    points = [a_point(generator, found, place) for place in range(count)]
    gains, machine = solved.gains, linearised(solved.design.machine)
    assert gains.position is not None
    drive = observed_drive(
        solved.design, (gains.i_d, gains.i_q), position_estimator(gains.position)
    )
    errors = {name: [point.errors[name] for point in points] for name in found.limits}
    omega = np.array([point.omega[0] for point in points])
    steady = steady_drives(drive, drive_cases(machine, omega, 0.0, errors))
    true = np.where(steady.found, steady.states[:, 2], omega)
    return [replace(point, true=float(each)) for point, each in zip(points, true, strict=True)]


@dataclass(frozen=True)
class Seen:
    """What a run did. ``swing`` and ``wrong``, of the speed at the end of each part, are shares of
    its reference; ``angle`` in degrees is the largest error of the angle, ``lowest`` the least
    speed in rad/s (electrical) from the first step on. ``early``: lost before it.
    """

    lost: bool
    early: bool
    swing: float
    wrong: float
    angle: float
    lowest: float

    def breaks(self, stated: float) -> str:
        """What is not kept; nothing where all is."""
        if self.lost:
            return "lost"
        if self.swing > SWING:
            return "swings"
        return "wrong speed" if self.wrong > stated + BESIDE else ""


def seen_of(run: Simulation, point: Point, course: Course, pole_pairs: int) -> Seen:
    """Figures of a run."""
    ends = (*course.instants, course.duration)
    swing = wrong = 0.0
    for begin, end in pairwise((course.climb, *ends)):
        if point.kind == "rest" and end == ends[1]:  # the load still rises
            continue
        late = (run.t > end - _LAST * (end - begin)) & (run.t < end - 1e-9)
        speed = run.omega_m[late] / run.reference[late]
        swing = max(swing, float(np.ptp(speed)))
        wrong = max(wrong, abs(float(np.mean(speed)) - 1.0))
    error = np.abs(angle_error(run))
    turned = float(np.max(error))
    lost = not run.figures.bounded[0] or not turned <= 0.5 * np.pi
    first = run.t < ends[0]
    early = lost and not float(np.max(error[first])) <= 0.5 * np.pi
    lowest = pole_pairs * float(np.min(run.omega_m[~first], initial=np.inf))
    return Seen(bool(lost), bool(early), swing, wrong, float(np.degrees(turned)), lowest)


def gone(program: Simulator, design: Design, point: Point, course: Course) -> Seen:
    """What a run does."""
    drive, pole_pairs = drive_of(design), design.machine.pole_pairs
    taken = 0.5 * _RISE * _FIRST * course.time
    if abs(point.true / point.omega[0] - 1.0) > BESIDE:  # the reference changes where it is passed
        alone = simulate(program, drive, point.scenario(course, pole_pairs, None))
        taken = float(alone.t[int(np.argmax(alone.sensorless))])
    stride = max(1, round(course.duration / design.control.t_s / ROWS))
    scenario = point.scenario(course, pole_pairs, taken)
    return seen_of(simulate(program, drive, scenario, stride=stride), point, course, pole_pairs)


def tried(
    program: Simulator, design: Design, point: Point, loop: tuple[LoopGains, CornerJudgement]
) -> tuple[Seen, bool]:
    """A run, and where its speed still moves at the end a longer one; whether it was repeated for
    what is not promised. Where the rotor was lost as it came onto its observer at speed with wrong
    data, the drive runs up from a low speed instead; where a load that rises to that of the corners
    took it below the range, it rises more slowly.
    """
    speed, found = loop
    held, omega = found.binding, point.omega[0]
    first = Course(float(np.clip(CROSSOVERS / speed.crossover, SHORTEST, LONGEST)))
    course, seen = first, gone(program, design, point, first)
    if seen.early:
        assert found.steps is not None
        low = min(1.0, _LOW * held.low / omega)
        slope = max(found.steps.speed, _SMALL * held.high) * speed.crossover / _GENTLE
        course = replace(course, climb=(1.0 - low) * omega / slope, low=low)
        seen = gone(program, design, point, course)
    if point.kind == "rest" and seen.breaks(held.speed_error) and seen.lowest < held.low:
        slope = _DIP * speed.ki * omega / found.pole_pairs  # of the load: its dip is slope/ki
        course = replace(course, slow=min(abs(point.loads[2]) / slope, SLOWEST))
        seen = gone(program, design, point, course)
    if seen.breaks(held.speed_error) in ("swings", "wrong speed"):
        seen = gone(program, design, point, replace(course, time=LONGER * course.time))
    return seen, course != first


@dataclass
class Row:
    """A drive: how it was refused, or what its runs did. ``failures`` have every run that did not
    keep what is stated, and ``design`` the drive, empty where all did.
    """

    method: ObserverMethodName
    number: int
    refused: str = ""
    points: int = 0
    repeated: int = 0
    lost: int = 0
    swings: int = 0
    wrong: int = 0
    angle: float = 0.0
    error: float = 0.0
    stated: float = 0.0
    lowest: float = 0.0
    failures: list[dict[str, object]] = field(default_factory=list)
    design: str = ""

    def take(self, place: int, point: Point, seen: Seen) -> None:
        """Count a run."""
        broken = seen.breaks(self.stated)
        self.points += 1
        self.lost += broken == "lost"
        self.swings += broken == "swings"
        self.wrong += broken == "wrong speed"
        if not seen.lost:
            self.angle, self.error = max(self.angle, seen.angle), max(self.error, seen.wrong)
        if broken:
            self.failures.append({
                "place": place, "broken": broken, **asdict(seen), **asdict(point),
            })  # fmt: skip


def sampled(method: ObserverMethodName, number: int, points: int, seed: int) -> Row:
    """A drive of a method, judged, and run at points of its box where it is accepted."""
    generator = np.random.default_rng([seed, METHODS.index(method), number])
    text = drawn(generator, method)
    design = load_text(text.encode(), f"drawn-{number}.yaml")
    solved, row = accepted(design), Row(method, number)
    if isinstance(solved, str):
        row.refused = solved
        return row
    speed, found = speed_gains(solved)
    row.stated = found.binding.speed_error
    prefix = design.export.prefix
    with simulator(controller_files(solved), prefix, observers_of(solved)[1]) as program:
        for place, point in enumerate(some_points(generator, solved, found, points)):
            seen, repeated = tried(program, design, point, (speed, found))
            row.take(place, point, seen)
            row.repeated += repeated
            if point.kind != "rest":  # whose load may take it below the range for a while
                lowest = seen.lowest / found.binding.low
                row.lowest = min(row.lowest or lowest, lowest)
    row.design = text if row.failures else ""
    return row


def plain(rows: Sequence[Row]) -> str:
    """Rows as JSON, one a line, figures with four digits, without what is as it begins."""
    lines = []
    for row in rows:
        begun = asdict(Row(row.method, row.number))
        own = {
            name: float(f"{value:.4g}") if isinstance(value, float) else value
            for name, value in asdict(row).items()
            if value != begun[name]
        }
        lines.append(json.dumps({"method": row.method, "number": row.number} | own))
    return "[\n" + ",\n".join(lines) + "\n]\n"


def read(path: Path) -> list[Row]:
    """Rows of a file."""
    return [Row(**each) for each in json.loads(path.read_text("utf-8"))]


def keep(paths: Sequence[Path]) -> None:
    """Put the rows of files in place of those of their methods in the tree."""
    new = [row for path in paths for row in read(path)]
    old = read(KEPT) if KEPT.exists() else []
    others = [row for row in old if row.method not in {each.method for each in new}]
    rows = sorted([*others, *new], key=lambda row: (METHODS.index(row.method), row.number))
    KEPT.write_text(plain(rows), "utf-8")


HEAD = (
    "method", "drives", "refused", "runs", "of these repeated", "rotor lost", "swinging",
    "speed beyond what is stated", "angle, deg", "speed, %",
)  # fmt: skip


def cells(method: ObserverMethodName, rows: Sequence[Row]) -> tuple[str, ...]:
    """The row of a method in the table; the last two are the largest errors."""
    own = [row for row in rows if row.method == method]
    held = [row for row in own if not row.refused]
    kinds = Counter(row.refused for row in own if row.refused)
    why = ", ".join(f"{count} {kind}" for kind, count in sorted(kinds.items()))
    counts = (sum(getattr(row, name) for row in held) for name in COUNTED)
    return (
        method, str(len(own)), f"{len(own) - len(held)} ({why})" if why else "0", *map(str, counts),
        f"{max((row.angle for row in held), default=0.0):.0f}",
        f"{100.0 * max((row.error for row in held), default=0.0):.1f}",
    )  # fmt: skip


COUNTED = ("points", "repeated", "lost", "swings", "wrong")


def table(rows: Sequence[Row]) -> Iterator[tuple[str, ...]]:
    """Cells of the table, its head first, a row per method."""
    yield HEAD
    for method in METHODS:
        if any(row.method == method for row in rows):
            yield cells(method, rows)


def main(words: Sequence[str] | None = None) -> int:
    """Sample drives of methods, print and write what was found; 1 where something is not kept."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n\n", maxsplit=1)[0])
    parser.add_argument("--method", choices=METHODS, action="append", help="default: all")
    parser.add_argument("--drives", type=int, default=60)
    parser.add_argument("--first", type=int, default=0, help="number of the first drive")
    parser.add_argument("--points", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--rows", type=Path, help="JSON file for all rows")
    parser.add_argument("--keep", type=Path, nargs="+", help="files of rows")
    asked = parser.parse_args(words)
    if asked.keep:
        keep(asked.keep)
        return 0
    rows = []
    for method in asked.method or METHODS:
        for number in range(asked.first, asked.first + asked.drives):
            row = sampled(method, number, asked.points, asked.seed)
            rows.append(row)
            print(
                f"{method} {number}: {row.refused or 'accepted'}, {row.points} runs, repeated "
                f"{row.repeated}, lost {row.lost}, swinging {row.swings}, wrong {row.wrong}, "
                f"angle {row.angle:.1f} deg, "
                f"speed {row.error:.2%} of {row.stated:.2%}, lowest {row.lowest:.2f}", flush=True,
            )  # fmt: skip
            if asked.rows is not None:
                asked.rows.write_text(plain(rows), "utf-8")
    print(*(f"| {' | '.join(line)} |" for line in table(rows)), sep="\n")
    return int(any(row.failures for row in rows))


if __name__ == "__main__":
    sys.exit(main())
