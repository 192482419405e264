"""What `check` calls valid runs, every refusal has a place, and numerical trouble is
one line without a warning.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from design_changes import Change, document, permitted, wrong
from drives import make_design

from dqforge import cli
from dqforge.machines.design import catalogue
from dqforge.machines.design.catalogue import load_text
from dqforge.machines.design.design import Design
from dqforge.machines.design.numerical import numerical_errors, on_design
from dqforge.machines.errors import DqforgeError, InputError, NoSolutionError, leading_path
from dqforge.optimizer.solution import solve
from dqforge.reports.run import run_design

DRIVES = [*catalogue.names(), "template"]


def outcome(change: Change, judge: Callable[[Design], object] | None = None) -> str:
    """Whether a changed design is valid or refused; a refusal has file, line,
    column and key on its one line.
    """
    return judged(change.text, change.what, judge)


def judged(text: bytes, what: str, judge: Callable[[Design], object] | None = None) -> str:
    found: DqforgeError | None = None
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            loaded = load_text(text, "design.yaml")
            _ = judge(loaded) if judge is not None else None
    except DqforgeError as error:
        found = error
    if found is None:
        return "valid"
    assert str(found).startswith(f"design.yaml:{found.line}:{found.column}: "), f"{what}: {found}"
    assert "\n" not in str(found), what
    assert 1 <= (found.line or 0) <= len(text.decode().splitlines()), what
    return "refused"


def test_the_walk_finds_every_word_and_every_end() -> None:
    """A few that a reader expects, and both ends of a range in SI units."""
    found = {change.what for change in permitted("template")}
    assert "inverter.device.kind is 'igbt'" in found
    assert (
        "inverter.device.diode_voltage left out" not in found
    )  # the template leaves it out itself
    assert {
        "inverter.dead_time is 0.0",
        "inverter.dead_time is 0.0001",
        "machine.poles left out",
    } <= found
    assert {
        "fit.form is 'closed-form'",
        "fit.continuous is False",
        "fit.method is 'lagrange'",
    } <= found
    assert len(found) > 500


def test_an_igbt_without_its_diode_is_refused_at_the_key() -> None:
    """What the template offers in a comment: the one word changed."""
    change = next(c for c in permitted("template") if c.what == "inverter.device.kind is 'igbt'")
    with pytest.raises(
        InputError, match=r"design\.yaml:\d+:\d+: inverter\.device: .*diode_voltage: 1\.2 V"
    ) as caught:
        load_text(change.text, "design.yaml")
    assert change.text.decode().splitlines()[(caught.value.line or 0) - 1].strip() == "kind: igbt"
    given = change.text.replace(b"kind: igbt", b"kind: igbt\n    diode_voltage: 1.2 V")
    assert judged(given, "given", solve) == "valid"


@pytest.mark.parametrize("one_in", [300, pytest.param(120, marks=pytest.mark.slow)])
def test_whatever_check_calls_valid_runs_or_is_refused_with_its_place(one_in: int) -> None:
    """One in so many of all changes of the template, the same ones every time."""
    found = [
        outcome(change, lambda design: run_design(design, verify=False))
        for change in _some("template", one_in)
    ]
    assert {"valid", "refused"} == set(found)


@pytest.mark.slow
@pytest.mark.parametrize("part", range(8))
def test_whatever_check_calls_valid_runs_over_the_whole_template(part: int) -> None:
    """Every second one of every word, both ends of every range and every key left out."""
    for change in list(permitted("template"))[2 * part :: 16]:
        outcome(change, lambda design: run_design(design, verify=False))


def _some(drive: str, step: int) -> list[Change]:
    return list(permitted(drive))[::step]


@pytest.mark.parametrize("drive", DRIVES)
def test_a_sample_of_broken_designs_is_refused_with_a_place(drive: str) -> None:
    changes = [*wrong(drive)][::160]
    assert "refused" in {outcome(change) for change in changes}


@pytest.mark.slow
@pytest.mark.parametrize("drive", DRIVES)
def test_no_refusal_of_a_broken_design_lacks_its_place(drive: str) -> None:
    """Thousands of designs: every key of every library drive left out, of the wrong kind,
    or out by powers of ten.
    """
    found = [outcome(change) for change in wrong(drive)]
    assert found.count("refused") > len(found) // 4


@pytest.mark.slow
@pytest.mark.parametrize("drive", DRIVES)
def test_no_refusal_of_a_solution_lacks_its_place(drive: str) -> None:
    """One in a hundred and fifty of the same designs, solved."""
    for change in [*wrong(drive)][::150]:
        outcome(change, solve)


# What is refused behind the reader, by modules that know no file;
# with the key that the message must name.
UNSOLVABLE = [
    (
        "control.observer.pole is '1e6 rad/s'",
        ("control", "observer", "pole"),
        "1e6 rad/s",
        "control.observer",
    ),
    (
        "a margin that no gain keeps",
        ("control", "current_loop", "min_phase_margin"),
        "89 deg",
        "control.current_loop",
    ),
    ("a torque beyond the limit", ("fit", "max_torque"), "900 N m", "fit.max_torque"),
]


@pytest.mark.parametrize(("what", "path", "value", "key"), UNSOLVABLE)
def test_refusals_of_the_solver_name_line_and_key(
    what: str, path: tuple[str, ...], value: str, key: str
) -> None:
    import yaml

    changed = document("template")
    inner = changed
    for part in path[:-1]:
        inner = inner[part]
    inner[path[-1]] = value
    text = yaml.safe_dump(changed, sort_keys=False)
    with pytest.raises(DqforgeError) as caught:
        solve(load_text(text.encode(), "design.yaml"))
    error = caught.value
    assert error.source == "design.yaml"
    assert key in error.message
    line = text.splitlines()[(error.line or 0) - 1].strip()
    assert line.split(":")[0] in key.split("."), what


def test_the_command_line_says_the_same_place(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = catalogue.template().decode().replace("pole: 400 rad/s", "pole: 1e6 rad/s")
    path = tmp_path / "design.yaml"
    path.write_text(text, encoding="utf-8")
    number = 1 + text.splitlines().index("  observer:")
    for command in (
        ["tune", str(path)],
        ["run", str(path), "--no-verify", "-o", str(tmp_path / "out")],
    ):
        with pytest.raises(SystemExit) as caught:
            cli.main(command)
        assert caught.value.code == 1
        assert capsys.readouterr().err.startswith(
            f"dqforge: {path}:{number}:3: control.observer: pole"
        )


@pytest.mark.parametrize("command", [["losses"], ["losses", "--choice"], ["simulate"], ["dqy"]])
def test_what_a_design_does_not_ask_for_is_refused_with_a_place(
    command: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    kept = document("template")
    del kept["losses"]
    import yaml

    path = tmp_path / "design.yaml"
    path.write_text(yaml.safe_dump(kept, sort_keys=False), encoding="utf-8")
    with pytest.raises(SystemExit) as caught:
        cli.main([command[0], str(path), *command[1:]])
    assert caught.value.code == 2
    assert f"{path}:1:1: " in capsys.readouterr().err


@on_design("fit")
def _divides(design: Design) -> float:
    return float(np.float64(design.machine.r_s) / np.float64(0.0))


@on_design("losses")
def _overflows(design: Design) -> float:
    return float(10.0**300 * design.machine.r_s) ** 20


@on_design("control")
def _singular(design: Design) -> float:
    return float(np.linalg.inv(np.zeros((2, 2)))[0, 0] * design.machine.r_s)


@on_design("control")
def _empty(design: Design) -> float:
    return float(np.mean(np.array([])) * design.machine.r_s)


@pytest.mark.parametrize(
    ("entry", "key"), [(_divides, "fit"), (_overflows, "losses"), (_singular, "control")]
)
def test_numerical_trouble_is_a_message_with_the_place(
    entry: Callable[[Design], float], key: str
) -> None:
    loaded = catalogue.load("paper001-pmsm-bench")
    with pytest.raises(
        NoSolutionError, match=rf"\.yaml:\d+:\d+: {key}: the numbers leave the range"
    ):
        entry(loaded)
    with pytest.raises(NoSolutionError, match=f"^{key}|^the numbers"):
        entry(make_design())


def test_warnings_of_numpy_become_messages_and_never_text_on_stderr(
    capfd: pytest.CaptureFixture[str],
) -> None:
    with pytest.raises(NoSolutionError, match=r"[Mm]ean of empty slice"):
        _empty(make_design())
    assert capfd.readouterr().err == ""


def test_wanted_infinities_stay(recwarn: pytest.WarningsRecorder) -> None:
    """A block that says so computes with them; other exceptions pass as they are."""
    with numerical_errors(), np.errstate(divide="ignore"):
        assert np.isinf(np.float64(1.0) / np.float64(0.0))
    with pytest.raises(KeyError), numerical_errors():
        raise KeyError("mine")
    with pytest.raises(ValueError, match="not numerical"), numerical_errors():
        raise ValueError("not numerical")
    assert not recwarn.list


@pytest.mark.parametrize(
    ("old", "new"),
    [("w: 2", "w: 2000"), ("w: 2", "w: 500"), ("s: 4", "s: 1e9"), ("t: 6", "t: 2e4")],
)
def test_an_exponent_that_makes_the_magnets_vanish_is_refused(old: str, new: str) -> None:
    text = catalogue.read_text("baldor-pmsyrm-5k6").decode()
    assert old in text
    with pytest.raises(InputError, match=r"d\.yaml:\d+:\d+: machine\.saturation\..*at most 20"):
        load_text(text.replace(old, new).encode(), "d.yaml")


@pytest.mark.parametrize(
    ("message", "path"),
    [
        ("control.observer: pole", ("control", "observer")),
        ("losses.points[3].torque: x", ("losses", "points", 3, "torque")),
        ("fit: no form", ("fit",)),
        ("900 N m is out of reach", ()),
        ("--map: too many", ()),
    ],
)
def test_the_key_that_a_message_begins_with(message: str, path: tuple[str | int, ...]) -> None:
    assert leading_path(message) == path


def test_places_are_no_part_of_what_makes_designs_equal() -> None:
    loaded = catalogue.load("paper001-pmsm-bench")
    assert loaded.places is not None
    assert replace(loaded, places=None) == loaded
