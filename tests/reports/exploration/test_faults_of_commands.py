"""What goes wrong while the command runs is a row, or one line: never half a part."""

from __future__ import annotations

from pathlib import Path

import pytest
from study_clusters import TESTS, cluster, free_port
from study_commands import Ended, explored, strange
from study_runs import rows_there

from dqforge import __version__
from dqforge.optimizer.exploration.row_block import STATES
from dqforge.reports.exploration.part_store import PartStore

pytestmark = pytest.mark.slow

STUDY = """\
dqforge_study: 1
name: Forty resistances
design: paper001-pmsm-bench
vary:
  machine.resistance: {range: {from: 2 Ohm, to: 3 Ohm, count: 40, spacing: linear}}
outputs: [gains.i_q.phase_margin]
"""


@pytest.fixture
def study(tmp_path: Path) -> Path:
    path = tmp_path / "study.yaml"
    path.write_text(STUDY, encoding="utf-8")
    return path


def crashed(out: Path) -> dict[int, tuple[float, str, bool]]:
    """Resistance and message of the rows that crashed, and whether they have a key."""
    found = {}
    for part in PartStore.existing(out).read(["in.machine.resistance", "key", "message"]):
        for row in range(part.count):
            if STATES[part.states[row]] == "crashed":
                found[part.first + row] = (
                    float(part.columns["in.machine.resistance"][row]),
                    part.messages[row],
                    bool(part.keys[row].any()),
                )
    return found


def test_a_row_that_ends_its_process_and_one_that_never_ends(study: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    words = ("--workers", 2, "--time-limit", 5)
    ended = explored(study, out, *words, **strange(KILLING=7, HANGING=31))
    assert (ended.code, ended.err) == (0, "")
    found = crashed(out)
    assert sorted(found) == [7, 31]
    assert found[7][1:] == ("ended its process 3 times", True)
    assert found[31][1:] == ("took longer than 5 s", True)
    assert [found[row][0] for row in (7, 31)] == pytest.approx([2.0 + 7 / 39, 2.0 + 31 / 39])
    assert rows_there(out) == list(range(40))
    assert "crashed, first: row 7: ended its process 3 times" in ended.out


def stopped(ended: Ended, out: Path) -> str:
    """The one line of a run that wrote no part."""
    assert (ended.code, ended.out) == (1, "")
    assert ended.err.count("\n") == 1
    assert not [*out.glob("parts/*")]
    return ended.err.removesuffix("\n")


def test_no_scheduler_and_a_worker_of_another_version(study: Path, tmp_path: Path) -> None:
    out, address = tmp_path / "out", f"tcp://127.0.0.1:{free_port()}"
    assert stopped(explored(study, out, "--scheduler", address), out) == (
        f"dqforge: explore: no scheduler answers at {address} within 10 s; start one with "
        "'dask scheduler', or leave --scheduler out"
    )
    other = tmp_path / "other" / "dqforge-0.0.1.dist-info"
    other.mkdir(parents=True)
    (other / "METADATA").write_text("Metadata-Version: 2.1\nName: dqforge\nVersion: 0.0.1\n")
    with cluster(tmp_path / "cluster", 0) as there:
        there.start_worker(PYTHONPATH=f"{other.parent}:{TESTS}")
        line = stopped(explored(study, out, "--scheduler", there.address), out)
    assert line.startswith("dqforge: explore: worker tcp://127.0.0.1:")
    assert line.endswith(
        f"has dqforge 0.0.1, here is {__version__}; install the same version on all workers"
    )
    assert explored(study, out, "--workers", 1).code == 0
    assert rows_there(out) == list(range(40))
