"""`dqforge explore` from its words to its lines and exit codes."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
from explore_calls import Call, explore_call
from study_runs import parts_hash, rows_there

from dqforge.reports.answers import explore

SMALL = """\
dqforge_study: 1
name: Two frequencies
design: paper001-pmsm-bench
vary:
  control.sampling_frequency: {values: [5 kHz, 10 kHz]}
  machine.resistance: {range: {from: 2 Ohm, to: 3 Ohm, count: 4, spacing: linear}}
outputs: [gains.i_q.phase_margin, gains.i_d.phase_margin]
"""


@pytest.fixture
def call(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Call:
    """The command in a folder with a small study: its exit code and what it printed."""
    monkeypatch.chdir(tmp_path)
    Path("small.yaml").write_text(SMALL, encoding="utf-8")

    return explore_call(capsys)


def test_a_study_is_computed_and_looked_into(call: Call) -> None:
    code, out, err = call("small.yaml", "--workers", 1)
    assert (code, err) == (0, "")
    assert "Two frequencies: 8 of 8 rows" in out
    assert "computed now: 8 rows in " in out
    assert "written: out/small" in out
    assert rows_there(Path("out/small")) == list(range(8))
    study = json.loads(Path("out/small/study.json").read_text(encoding="utf-8"))
    assert study["outcome"]["states"]["ok"] == 8
    before = parts_hash(Path("out/small"))
    code, out, _ = call("small.yaml")
    assert (code, "computed now" in out) == (0, False)
    assert parts_hash(Path("out/small")) == before
    code, out, _ = call("out/small")
    assert (code, "8 of 8 rows" in out) == (0, True)
    code, out, _ = call(
        "out/small", "--table", "machine.resistance", "--sort", "-machine.resistance"
    )
    assert (code, "3 Ohm" in out) == (0, True)


def test_json_says_the_same_each_time(call: Call) -> None:
    code, first, err = call("small.yaml", "--workers", 1, "--json")
    assert (code, err) == (0, "")
    assert call("small.yaml", "--workers", 1, "--json", "--restart")[1] == first
    study = json.loads(first)["study"]
    assert study["rows"] == 8
    assert study["states"]["ok"] == 8
    assert study["failures"] == []
    assert study["out"] == "out/small"


def test_a_dry_run_estimates_and_writes_nothing(call: Call) -> None:
    code, out, _ = call("small.yaml", "--dry-run")
    assert code == 0
    assert "8 rows in 1 parts of" in out
    assert "2 Ohm" in out
    assert "3 Ohm" in out
    assert "(from 8 rows)" in out
    assert not Path("out").exists()


@pytest.mark.parametrize("other", [("--dry-run",), ("--table", "losses.total"), ("--export", "0")])
def test_a_figure_is_of_all_rows(call: Call, other: tuple[str, ...]) -> None:
    code, _, err = call("small.yaml", "--plot", "front.svg", *other)
    assert code == 2
    assert "--plot draws all rows: omit --dry-run, --table, --csv and --export" in err
    assert not Path("front.svg").exists()
    assert not Path("out").exists()


def test_another_study_in_the_folder_is_refused(call: Call) -> None:
    assert call("small.yaml", "-o", "there", "--workers", 1)[0] == 0
    before = parts_hash(Path("there"))
    Path("other.yaml").write_text(SMALL.replace("3 Ohm", "4 Ohm"), encoding="utf-8")
    code, _, err = call("other.yaml", "-o", "there", "--workers", 1)
    assert code == 2
    assert "there holds another study (1 of " in err
    assert "machine.resistance" in err
    assert "take another -o, or --restart" in err
    assert parts_hash(Path("there")) == before
    assert call("other.yaml", "-o", "there", "--workers", 1, "--restart")[0] == 0
    assert parts_hash(Path("there")) != before


def test_broken_limits_are_results_and_failures_alone_end_with_1(call: Call) -> None:
    limits = "limits: {gains.i_q.phase_margin: {above: 179 deg}}\n"
    Path("broken.yaml").write_text(SMALL + limits, encoding="utf-8")
    code, out, _ = call("broken.yaml", "--workers", 1)
    assert code == 0
    assert "limit" in out


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (["--scheduler", "tcp://a:1", "--scheduler-file", "f"], "name one cluster"),
        (["--scheduler", "tcp://a:1", "--workers", "2"], "--workers counts processes of this"),
        (["--tls-ca-file", "a"], "TLS needs an existing cluster"),
        (
            ["--scheduler", "tcp://a:1", "--tls-ca-file", "a"],
            "TLS takes --tls-ca-file and --tls-cert",
        ),
        (["--workers", "0"], "--workers"),
        (["--limit", "0"], "--limit"),
    ],
)
def test_words_that_exclude_each_other(call: Call, words: list[str], line: str) -> None:
    code, out, err = call("small.yaml", *words)
    assert (code, out) == (2, "")
    assert line in err
    assert err.count("\n") == 1


def test_a_missing_extra_is_named(call: Call, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(explore, "find_spec", lambda name: None if name == "pyarrow" else name)
    code, out, err = call("small.yaml")
    assert (code, out) == (1, "")
    assert err == "dqforge: explore: pyarrow is missing; pip install 'dqforge[explore]'\n"


def test_the_command_line_loads_nothing_of_it() -> None:
    check = "import sys, dqforge.cli; print([m for m in sys.argv[1:] if m in sys.modules])"
    words = [sys.executable, "-c", check, "distributed", "pyarrow", "scipy.stats", "numpy"]
    run = subprocess.run(words, capture_output=True, text=True, check=True)
    assert run.stdout == "[]\n"
