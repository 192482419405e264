"""The checker of the speed loop confirms what is written, and finds what is planted in it."""

from __future__ import annotations

import itertools
import json
import math
import re
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from random_speed_loops import SpeedDrive, random_speed_drive
from scipy.linalg import expm

from dqforge.checker import check_speed as checker
from dqforge.machines.arrays import FloatArray
from dqforge.machines.design import catalogue
from dqforge.machines.design.catalogue import load
from dqforge.machines.errors import VerificationError
from dqforge.optimizer.control_design.gain_set import solve_gains
from dqforge.optimizer.loops.pi_methods import DriveVariants, close_loops, speed_plants
from dqforge.optimizer.solution import solve
from dqforge.optimizer.speed_box import Effort, SpeedSearch, plain_certificate
from dqforge.reports.run import emitted_files
from dqforge.reports.verification.independent import certificate_files, check_independently

# Library drives with tolerances and a speed loop on a measured speed.
COVERED = (
    "anaheim-bly172s",
    "brusa-hsm1",
    "cubemars-ak80-9",
    "estun-emj-04apb",
    "hurst-dmb0224c10002",
    "nanotec-db42m03",
    "teknic-m2310p",
)
# Drawn drives by seed and ratio: one whose box is cut, and one whose speed is filtered.
CUT, FILTERED = (7, 2), (1, 2)
DRAWN = (CUT, FILTERED, (2, 1))
SLOW = (
    *((seed, ratio) for seed in range(4, 12) for ratio in (1, 2, 5)),
    (4, 10),
    (5, 20),
    (11, 20),
)
Plain = dict[str, Any]
Change = Callable[[str, Plain], str]


def inputs_of(drive: SpeedDrive) -> Plain:
    """Control and drives as a certificate has them."""
    (r_s, inductance, t_s), (inertia, friction, filter_time) = drive.winding, drive.mechanics
    box, ratio = drive.box, drive.loop.ratio

    def times(factor: float, span: tuple[float, float]) -> list[float]:
        return [factor * side for side in span]

    return {
        "t_s": t_s,
        "kp": drive.current[0],
        "ki_ts": drive.current[1] * t_s,
        "speed_kp": drive.speed[0],
        "speed_ki_ts": drive.speed[1] * ratio * t_s,
        "ratio": ratio,
        "filter_time": filter_time,
        "friction": friction,
        "r_s": times(r_s, box.resistance),
        "dead_time": times(r_s, box.dead_time),
        "l_q": times(inductance, box.inductance),
        "gain": list(box.gain),
        "torque": list(box.torque),
        "inertia": [inertia / box.inertia[1], inertia / box.inertia[0]],
        "back_emf": list(box.back_emf),
        "inductance_scale": inductance,
        "speed_scale": drive.loop.scale / drive.speed[0],
    }


def header_of(drive: SpeedDrive) -> str:
    """A header with what the checker reads."""
    law, inputs = "d[k] = d[k-1] + kp (e[k] - e[k-1]) + ki_ts e[k]", inputs_of(drive)
    lines = [f"/* PI controller of {of}: given\n * {law}\n */" for of in ("i_q", checker.SPEED)]
    lines += ["/* speed loop: proven stable for every drive in the box */"]
    for name, constant in checker.CONSTANTS.items():
        value = f"{np.float32(inputs[name]):.9g}F"
        lines.append(f"#define D_{constant} ({drive.loop.ratio if name == 'ratio' else value})")
    flux = np.float32(drive.constant / 1.5)
    lines += ["#define D_POLE_PAIRS (1)", f"#define D_PSI_PM_WB ({flux:.9g}F)"]
    return "\n".join(lines) + "\n"


@cache
def drive_of(seed: int, ratio: int) -> SpeedDrive:
    """A random drive; some have a torque that is not quite the commanded one."""
    drive = random_speed_drive(np.random.default_rng(seed), ratio)
    if seed % 2 == 0:
        return drive
    torque = (0.95, 1.05)
    loop = replace(drive.loop, uneven=1.0 / torque[0] - 1.0)
    return replace(drive, loop=loop, box=replace(drive.box, torque=torque))


@cache
def drawn(seed: int, ratio: int, cells: int = 40) -> tuple[str, str]:
    """Header and certificate of a drawn drive."""
    drive = drive_of(seed, ratio)
    tree = SpeedSearch(drive.loop, drive.box, Effort(cells)).run()
    assert tree.counterexample is None
    units = np.array([1.0, drive.winding[0], 1.0 / drive.mechanics[0], 1.0])
    header = header_of(drive) if tree.complete else header_of(drive).replace("speed loop: p", "p")
    return header, json.dumps(plain_certificate(inputs_of(drive), units, tree))


def said(
    header: str,
    certificate: str,
    folder: Path,
    capsys: pytest.CaptureFixture[str],
    control: str = "",
) -> str:
    """The last line that the checker prints."""
    (folder / "d.h").write_text(header)
    (folder / "d_control.h").write_text(control)
    path = folder / "d_speed.json"
    path.write_text(certificate)
    capsys.readouterr()
    code = checker.main([str(path)])
    line = capsys.readouterr().out.splitlines()[-1]
    assert code == (1 if line.startswith("not confirmed: ") else 0)
    return line


def test_the_checker_runs_alone(tmp_path: Path) -> None:
    header, certificate = drawn(*CUT)
    (tmp_path / "d.h").write_text(header)
    path = tmp_path / "d_speed.json"
    path.write_text(certificate)
    command = [sys.executable, "-I", "-S", checker.__file__, str(path)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    first, second = done.stdout.splitlines()
    assert first.startswith("not covered: limits of torque")
    assert second.startswith("confirmed: the speed loop, with the current loop of the q axis ")
    summary = check_independently(tmp_path).splitlines()[0]
    assert summary.startswith("confirmed: the speed loop; not covered of the speed loop: limits of")
    (tmp_path / "d.h").write_text(header.replace("RATIO (2)", "RATIO (3)"))
    with pytest.raises(VerificationError, match="another SPEED_RATIO"):
        check_independently(tmp_path)


@pytest.mark.parametrize(
    ("seed", "ratio"), [*DRAWN, *(pytest.param(*pair, marks=pytest.mark.slow) for pair in SLOW)]
)
def test_drawn_designs(
    seed: int, ratio: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert said(*drawn(seed, ratio), tmp_path, capsys).startswith("confirmed: ")


def loop_of(drive: SpeedDrive) -> checker.Loop:
    header = checker.Header(header_of(drive), "d")
    return checker.Loop(checker.Box(inputs_of(drive), header))


def floats(rows: list[list[int]]) -> FloatArray:
    return np.array([[entry / checker.ONE for entry in row] for row in rows])


def parameters(drive: SpeedDrive, points: FloatArray) -> list[checker.Point]:
    """Points (b, c, j, e) as the checker has them."""
    (r_s, _, _), (inertia, _, _) = drive.winding, drive.mechanics
    units = np.array([1.0, r_s, 1.0 / inertia, 1.0])
    return [tuple(map(Fraction, point)) for point in points * units]


@pytest.mark.parametrize(("seed", "ratio"), [(1, 2), (2, 1), (4, 5), (6, 10)])
def test_poles_are_those_of_the_loops_own_model(seed: int, ratio: int) -> None:
    """In physical quantities, without this model's units; with the gains of the header."""
    drive = drive_of(seed, ratio)
    loop = loop_of(drive)
    assert loop.moving == (3 if drive.mechanics[2] > 0.0 else 2)
    (r_s, inductance, t_s), (inertia, friction, filter_time) = drive.winding, drive.mechanics
    t_s = float(np.float32(t_s))
    points = drive.box.samples(10, np.random.default_rng(seed))
    (b, c, j, e), gain = points.T, 0.9
    kp, ki_ts, speed_kp, speed_ki_ts = (
        float(np.float32(inputs_of(drive)[name]))
        for name in ("kp", "ki_ts", "speed_kp", "speed_ki_ts")
    )
    plants = speed_plants(
        DriveVariants(
            r_s=c / b * gain * r_s,
            l_q=gain / b * inductance,
            inertia=inertia / j,
            gain=np.full(len(b), gain),
            torque_factor=np.ones(len(b)),
            back_emf=e * gain * float(np.float32(drive.constant / 1.5) * 1.5),
        ),
        friction,
        t_s,
        (kp, ki_ts / t_s),
        ratio,
        filter_time,
    )
    expected = close_loops(plants, speed_kp, speed_ki_ts / (ratio * t_s)).radius
    for point, radius in zip(parameters(drive, points), expected, strict=True):
        step = loop.step(point)
        assert step.r < 2**20
        cycle = np.linalg.matrix_power(floats(step.rows), ratio) @ floats(loop.update().rows)
        whole = np.delete(cycle, loop.size - 2, axis=0)
        assert np.max(np.abs(np.linalg.eigvals(whole))) == pytest.approx(radius, abs=1e-8)


@pytest.mark.parametrize(("seed", "ratio"), [(1, 2), (3, 5), (4, 5)])
def test_rests_hold_what_the_corners_leave_out(seed: int, ratio: int) -> None:
    """Random points of random cells, with a torque that is not the commanded one."""
    drive, random = drive_of(seed, ratio), np.random.default_rng(seed)
    loop, nearest = loop_of(drive), 0.0
    k = loop.moving
    points = drive.box.samples(24, random)
    for pair in zip(points[::2], points[1::2], strict=True):
        ends = parameters(drive, np.sort(pair, axis=0))
        bounds = floats(checker.rests(loop, *ends))
        sides = np.array([[float(side) for side in end] for end in ends])
        share = random.uniform(0.2, 0.8, 4)
        chosen = np.array(list(itertools.product((0, 1), repeat=4)))
        weights = np.where(chosen == 1, share, 1.0 - share).prod(axis=1)
        corners = [loop.step(corner) for corner in itertools.product(*zip(*ends, strict=True))]
        steps = np.array([floats(step.rows)[:k, : k + 1] for step in corners])
        mean = np.tensordot(weights, steps, 1)
        inside = tuple(map(Fraction, sides[0] + share * (sides[1] - sides[0])))
        flow = np.array([[float(x) for x in row] for row in loop.flow(inside)])
        flow[1, 1] /= random.choice(drive.box.torque)  # f in the friction
        exact = expm(flow)[:2]
        if k == 3:
            kept = math.exp(-loop.box.t_s / loop.box.filter_time)
            exact = np.insert(np.vstack([exact, (1.0 - kept) * exact[1]]), 2, 0.0, axis=1)
            exact[2, 2] = kept
        error = np.abs(exact - mean)
        assert (error <= bounds + 1e-14).all()
        large = bounds > 1e-9
        nearest = max(nearest, float(np.max(error[large] / bounds[large])))
    assert nearest > 0.3  # they are no more than a few times too large


def scaled(name: str, factor: float, *, both: bool = True) -> Change:
    """A constant of the header times a factor, and the same of the inputs."""

    def change(header: str, plain: Plain) -> str:
        constant = checker.CONSTANTS[name]
        value = float(re.findall(rf"D_{constant} \((\S+?)F?\)", header)[0]) * factor
        if both:
            plain["inputs"][name] = value
        number = f"{value:.0f}" if name == "ratio" else f"{value:.10g}F"
        return re.sub(rf"(D_{constant}) \(\S+\)", rf"\1 ({number})", header)

    return change


def test_gains_beyond_the_limit_are_not_confirmed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A corner of the box is unstable, whatever the witness: that of gains which are not too
    large, and the cells of the same box without a cut.
    """
    header, certificate = drawn(*DRAWN[2])
    drive = drive_of(*DRAWN[2])
    corners = drive.box.samples(200, np.random.default_rng(1))
    for factor in (1.0, 1.5, 2.0, 4.0, 8.0, 16.0, 32.0):
        wild = replace(drive, loop=replace(drive.loop, scale=drive.loop.scale * factor))
        unstable = float(np.max(wild.radii(corners))) >= 1.0
        plain = json.loads(certificate)
        changed = scaled("speed_kp", factor)(header, plain)
        changed = scaled("speed_ki_ts", factor)(changed, plain)
        line = said(changed, json.dumps(plain), tmp_path, capsys)
        assert line.startswith("not confirmed: ") or not unstable
        assert line.startswith("confirmed: ") or factor > 1.0
    assert unstable


def test_cells_that_are_left_open_are_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    header, certificate = drawn(*CUT)
    plain = json.loads(certificate)
    assert len(plain["tree"]) > 2
    plain["tree"][-1] = "open"
    line = said(header, json.dumps(plain), tmp_path, capsys)
    assert re.search("says it of every drive; b .* is left open", line)
    unsaid = header.replace("speed loop: proven", "")
    line = said(unsaid, json.dumps(plain), tmp_path, capsys)
    assert re.search("every drive but those in 1 cells that are left open .b ", line)


CONTROL = """    {{ {kp}F, {ki_ts}F, 0.1F }}, /* i_q: kp, ki t_s, tracking */
    {{ {speed_kp}F, {speed_ki_ts}F, 0.02F }}, /* speed: kp, ki t_s, tracking */
    {share}F, /* speed_filter, 1 */
    {ratio}U /* current samples per speed sample */
"""


def test_the_header_of_the_control_runs_on_the_same(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    header, certificate = drawn(*FILTERED)
    inputs = json.loads(certificate)["inputs"]
    assert inputs["filter_time"] > 0.0
    share = -np.expm1(-inputs["t_s"] / inputs["filter_time"])
    numbers = {name: f"{np.float32(inputs[name]):.9g}" for name in ("kp", "ki_ts", "speed_kp")}
    numbers |= {"speed_ki_ts": f"{np.float32(inputs['speed_ki_ts']):.9g}"}
    numbers |= {"share": f"{np.float32(share):.9g}", "ratio": str(inputs["ratio"])}
    control = CONTROL.format(**numbers)
    assert said(header, certificate, tmp_path, capsys, control).startswith("confirmed: ")
    for name, value in numbers.items():
        other = CONTROL.format(**numbers | {name: f"{float(value) * 1.00001:.9g}"})
        line = said(header, certificate, tmp_path, capsys, other)
        assert re.search("header of the control has (another number|not one line)", line)
    for line in CONTROL.format(**numbers).splitlines():
        shown = said(header, certificate, tmp_path, capsys, control.replace(line, ""))
        assert "has not one line of" in shown


def texts(old: str, new: str) -> Change:
    """Another text in the header."""

    def change(header: str, plain: Plain) -> str:
        assert old in header
        return header.replace(old, new)

    return change


def stated(name: str, factor: float, place: int | None = None) -> Change:
    """An input, or an end of a range, times a factor."""

    def change(header: str, plain: Plain) -> str:
        held, at = (plain["inputs"], name) if place is None else (plain["inputs"][name], place)
        held[at] = held[at] * factor or factor - 1.0
        return header

    return change


def rows(work: Callable[[list[Any]], Any]) -> Change:
    """Another tree."""

    def change(header: str, plain: Plain) -> str:
        work(plain["tree"])
        return header

    return change


def put(row: int, verdict: Any) -> Change:
    """Another verdict."""
    return rows(lambda tree: tree.__setitem__(row, verdict))


def without(row: int) -> Change:
    """A verdict left out."""
    return rows(lambda tree: tree.pop(row))


def repeated(row: int) -> Change:
    """A verdict twice."""
    return rows(lambda tree: tree.insert(row, tree[row]))


def entry(row: int, matrix: int, place: int) -> Change:
    """An entry of a matrix with the other sign."""
    return rows(lambda tree: tree[row][matrix].__setitem__(place, -tree[row][matrix][place]))


def planted(tree: list[Any]) -> dict[str, tuple[Change, str]]:
    """Faults by name, each with what must be said of it."""
    faults: dict[str, tuple[Change, str]] = {}
    for name, key in checker.CONSTANTS.items():
        small = 2.0 if name == "ratio" else 1.000001
        faults[f"last digits of {key}"] = scaled(name, small, both=False), f"another {key}"
        faults[f"sign of {key}"] = scaled(name, -1.0), "row|not positive|no number"
        faults[f"{key} times 10"] = scaled(name, 10.0), "row"
    for name, factor in (("r_s", 4.0), ("l_q", 3.0), ("gain", 3.0), ("torque", 3.0)):
        faults[f"{name} wider"] = stated(name, factor, 1), "row"
        faults[f"{name} crossed"] = stated(name, 0.1, 1), f"{name}: it ends before"
    for name in ("l_q", "gain", "torque", "inertia"):
        faults[f"{name} negative"] = stated(name, -1.0, 0), f"{name}: it is not positive"
    faults["inertia wider"] = stated("inertia", 0.1, 0), "row"
    faults["back_emf wider"] = stated("back_emf", 1e9, 1), "row"
    for name in ("friction", "filter_time"):
        faults[f"{name} negative"] = stated(name, -1.0), "is negative"
    for name in ("inductance_scale", "speed_scale"):
        faults[f"{name} negative"] = stated(name, -1.0), "not positive"
        faults[f"{name} larger"] = stated(name, 100.0), "row"
    for row, verdict in enumerate(tree):
        here = f"row {row} |row {row + 1} |left out at its end"
        faults[f"row {row} left out"] = without(row), "row|left out"
        faults[f"row {row} repeats"] = repeated(row), "row|left out|cut already"
        faults[f"row {row} empty"] = put(row, "empty"), f"row {row} .*holds drives"
        if not isinstance(verdict[0], list):
            faults[f"cut {row} far off"] = put(row, [verdict[0], 1e9]), f"row {row} .*outside"
            faults[f"cut {row} of no parameter"] = put(row, [4, verdict[1]]), f"row {row} "
            continue
        faults[f"row {row} open"] = put(row, "open"), "left open"
        faults[f"row {row}, a matrix less"] = put(row, verdict[:-1]), "for every sample"
        faults[f"row {row} turned"] = put(row, [verdict[0], *verdict[:0:-1]]), here
        short = [verdict[0][:-1], *verdict[1:]]
        faults[f"row {row} too short"] = put(row, short), f"row {row} .*as many entries"
        for matrix, held in enumerate(verdict):
            for place in (0, 1, len(held) - 1):
                name = f"row {row}, matrix {matrix}, entry {place}"
                faults[name] = entry(row, matrix, place), f"row {row} "
    twice = "#define D_T_S_S (1.0F)"
    faults |= {
        "one cell for all": (rows(lambda tree: tree.__setitem__(slice(None), tree[-1:])), "row 0 "),
        "no tree": (rows(lambda tree: tree.clear()), "left out"),
        "no such verdict": (put(0, 7), "neither cut, empty"),
        "an input less": (lambda header, plain: plain["inputs"].pop("torque") and header, "inputs"),
        "sign of the integral": (texts("+ ki_ts e[k]", "- ki_ts e[k]"), "another law of i_q"),
        "another loop": (texts(checker.SPEED, "the position"), "another law of the speed"),
        "a constant twice": (texts("#define D_T_S_S", f"{twice}\n#define D_T_S_S"), "twice"),
        "a constant less": (texts("D_IQ_KP", "D_IX_KP"), "has no D_IQ_KP"),
        "flux linkage": (texts("D_PSI_PM_WB (", "D_PSI_PM_WB (1000"), "row"),
    }
    return faults


@pytest.mark.parametrize(
    "part", [0, *(pytest.param(k, marks=pytest.mark.slow) for k in range(1, 5))]
)
def test_planted_faults_are_found(
    part: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    header, certificate = drawn(*CUT)
    faults = planted(json.loads(certificate)["tree"])
    assert len(faults) >= 80
    missed = {}
    for name, (change, place) in list(faults.items())[part::5]:
        plain = json.loads(certificate)
        changed = change(header, plain)
        line = said(changed, json.dumps(plain), tmp_path, capsys)
        if not line.startswith("not confirmed: ") or not re.search(place, line):
            missed[name] = line
    assert missed == {}


@pytest.mark.slow
@pytest.mark.parametrize("name", COVERED)
def test_library_drives(name: str, tmp_path: Path) -> None:
    solution = solve(replace(load(name), losses=None))
    assert solution.loops is not None
    assert solution.loops.proofs.speed is not None
    assert solution.loops.proofs.speed.complete
    files = emitted_files(solution)
    files |= certificate_files(solution, files)
    for file, content in files.items():
        (tmp_path / file).write_bytes(content)
    path = tmp_path / f"{solution.design.export.prefix}_speed.json"
    assert checker.main([str(path)]) == 0


@pytest.mark.slow
def test_all_library_drives_with_a_proof_are_covered() -> None:
    asked = set()
    for name in (*catalogue.names(), *catalogue.motors()):
        if "  tolerances: " in catalogue.read_text(name).decode():
            asked |= {name} if solve_gains(load(name)).proofs.speed is not None else set()
    assert asked == set(COVERED)
