"""Which costly tests a run takes: first those near a change, then by turns, within a given time.

`tests/costs.json` keeps the seconds of processor time of every file of tests that takes long (its
cases share what they set up, so that a file costs the same whichever of them run), and of every
case of the campaign; what is not listed is cheap and always runs, as do the files of `ALWAYS`.
``--drawn 90`` fills 90 s of processor time: first the files beside the modules that the working
tree or the commits of the last day change, then others in an order that the commit gives, so that
each has its turn; without the option all of them run. Files of which no case would run are not
imported. ``--always PATH`` keeps what lies there whatever it costs. ``--keep-costs`` writes the
file anew from what a run without the option took.

As a program, ``python tests/drawn_cases.py 2 NAME...`` prints the two names whose turn it is.
"""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
import sys
from collections import defaultdict
from collections.abc import Generator, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import pytest

HERE = Path(__file__).parent
COSTS = HERE / "costs.json"
COSTLY_S = 0.4
# What changes of any room meet: how the code is built, worded and written down.
ALWAYS = tuple(
    f"tests/{name}.py"
    for name in (
        "checker/test_programs", "reports/test_printing_computes_nothing", "site/test_reference",
        "test_docstrings", "test_formulas", "test_house", "test_wording",
    )
)  # fmt: skip
# What a case of the campaign is taken to cost before it was first measured.
UNKNOWN_S = 3.0
CLOCK = "processor_s"
OF_KEPT = "tests/test_kept_output.py::test_it_is_as_it_was_kept["


def _git(*words: str) -> str:
    found = subprocess.run(
        ["git", *words], cwd=HERE.parent, capture_output=True, text=True, check=False
    )
    return found.stdout


@cache
def commit() -> str:
    """The commit that is tested."""
    return _git("rev-parse", "--short=12", "HEAD").strip() or "no commit"


@cache
def seed() -> str:
    """The commit that is tested, or what ``DQFORGE_SEED`` says."""
    return os.environ.get("DQFORGE_SEED") or commit()


@cache
def changed_rooms() -> frozenset[str]:
    """Folders and modules of the product that the working tree or the last day's commits change, or
    tests of them.

    The day ends with the last commit, so that the same commit draws the same.
    """
    day_before = int(_git("show", "-s", "--format=%ct") or 0) - 86400
    names = _git("log", f"--since=@{day_before}", "--format=", "--name-only").split()
    names += _git("diff", "--name-only", "HEAD").split()
    names += _git("ls-files", "--others", "--exclude-standard").split()
    paths = [Path(name.replace("/templates", "").removeprefix("tests/")) for name in names]
    modules = {path.with_suffix("") for path in paths if path.suffix == ".py"}
    return frozenset(path.as_posix() for path in {path.parent for path in paths} | modules)


def near(name: str) -> bool:
    """Whether a file of tests lies beside what is being changed, or a case comes to it."""
    if name.startswith(OF_KEPT):
        kept = json.loads((HERE / f"kept/{name[len(OF_KEPT) :].rstrip(']')}.json").read_text())
        return not changed_rooms().isdisjoint(path[:-3] for path in kept["values"])
    return Path(name).parent.as_posix().removeprefix("tests/") in changed_rooms()


def turn(name: str) -> str:
    """Place of a case or file in the order of this commit."""
    return hashlib.sha256(f"{seed()} {name}".encode()).hexdigest()


def function_of(name: str) -> str:
    """The test function of a case."""
    return name.partition("[")[0]


def kept_costs() -> dict[str, float]:
    """Seconds of every file and case of the campaign that takes long, by its name."""
    found: dict[str, float] = json.loads(COSTS.read_text(encoding="utf-8"))
    return found


def of_the_campaign(item: pytest.Item) -> bool:
    """Whether a case is left to the campaign."""
    return any(item.get_closest_marker(mark) is not None for mark in ("slow", "benchmark"))


def unit_of(item: pytest.Item) -> str:
    """What is drawn as a whole: a case of the campaign and one of what is kept by itself, all
    others with their file.
    """
    alone = of_the_campaign(item) or item.nodeid.startswith(OF_KEPT)
    return item.nodeid if alone else item.nodeid.partition("::")[0]


def cost_of(item: pytest.Item, costs: dict[str, float]) -> float:
    """Seconds that the unit of a case is expected to take; 0 where it is cheap."""
    return costs.get(unit_of(item), UNKNOWN_S if of_the_campaign(item) else 0.0)


def drawn(
    items: list[pytest.Item], budget: float, costs: dict[str, float], always: Sequence[str] = ()
) -> list[pytest.Item]:
    """The cheap cases and what lies below ``always``, and of the others those whose turn it is, as
    long as seconds are left.

    Their order is that of ``items``.
    """
    units = {unit_of(item): cost_of(item, costs) for item in items}
    kept = filling(budget, units, always)
    return [item for item in items if unit_of(item) in kept]


def filling(budget: float, units: dict[str, float], always: Sequence[str] = ()) -> set[str]:
    """The units, of these with their costs, that `drawn` keeps."""
    left, kept, always = budget, set(), (*ALWAYS, *always)
    for unit in sorted(units, key=lambda unit: (not near(unit), turn(unit))):
        cost = 0.0 if unit.startswith(always) else units[unit]
        if cost <= left or cost == 0.0:
            kept.add(unit)
            left -= cost
    return kept


def _processor_s() -> float:
    """Processor time of this process and of those that it has waited for, in s."""
    return sum(os.times()[:4])


class Clock:
    """Notes with each case the processor time that it took, whichever process runs it."""

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self) -> Generator[None, bool, bool]:
        """Start with the case."""
        self.start = _processor_s()
        return (yield)

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_makereport(
        self, item: pytest.Item, call: pytest.CallInfo[None]
    ) -> Generator[None, pytest.TestReport, pytest.TestReport]:
        """Note the time with the last report of the case."""
        report = yield
        if call.when == "teardown":
            cost = _processor_s() - self.start
            report.user_properties.append((CLOCK, json.dumps([unit_of(item), cost])))
        return report


class Costs:
    """Collects what files and cases took, and keeps it."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = defaultdict(float)

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Add a case to its unit."""
        for name, noted in report.user_properties:
            if name == CLOCK:
                unit, cost = json.loads(str(noted))
                self.seconds[unit] += cost

    def pytest_sessionfinish(self) -> None:
        """Write what the costly ones took; those that did not run keep what they had."""
        costs = {name: cost for name, cost in kept_costs().items() if name not in self.seconds}
        costs |= {name: round(cost, 1) for name, cost in self.seconds.items() if cost > COSTLY_S}
        text = json.dumps(dict(sorted(costs.items())), indent=1)
        COSTS.write_text(text + "\n", encoding="utf-8")


def add_options(parser: pytest.Parser) -> None:
    """Declare the options."""
    parser.addoption(
        "--drawn",
        type=float,
        metavar="SECONDS",
        help="of what is costly only so many: what lies near a change, then drawn by the commit",
    )
    parser.addoption(
        "--always", nargs="+", default=(), metavar="PATH", help="with --drawn: not to be left out"
    )
    parser.addoption("--keep-costs", action="store_true", help="write tests/costs.json anew")


def configure(config: pytest.Config) -> None:
    """Count seconds where they are to be kept, in the process that hears of every case."""
    if config.getoption("--keep-costs"):
        config.pluginmanager.register(Clock())
        if not hasattr(config, "workerinput"):
            config.pluginmanager.register(Costs())


def needless_files(config: pytest.Config) -> frozenset[Path]:
    """Files of which no case would run, so that they need not be imported.

    None where the campaign is asked for, since its cases are drawn one by one.
    """
    budget: Any = config.getoption("--drawn")
    marks = config.getoption("markexpr")
    if budget is None or not ("not slow" in marks and "not benchmark" in marks):
        return frozenset()
    asked = [config.rootpath / arg.partition("::")[0] for arg in config.args]
    costs = {
        name: cost
        for name, cost in kept_costs().items()
        if (path := config.rootpath / name).is_file() and any(map(path.is_relative_to, asked))
    }
    kept = filling(budget, costs, config.getoption("--always"))
    measuring = [path for path in (HERE / "benchmarks").glob("*.py") if _all_measures(path)]
    return frozenset({config.rootpath / name for name in costs.keys() - kept}.union(measuring))


def _all_measures(path: Path) -> bool:
    """Whether every case of a file is a benchmark."""
    return "\npytestmark = pytest.mark.benchmark\n" in path.read_text(encoding="utf-8")


def leave_out(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Take out what is costly and whose turn it is not."""
    budget: Any = config.getoption("--drawn")
    if budget is None:
        return
    kept = drawn(items, budget, kept_costs(), config.getoption("--always"))
    runs = set(kept)
    config.hook.pytest_deselected(items=[item for item in items if item not in runs])
    items[:] = kept


def headline(config: pytest.Config) -> str:
    """What a run says of the draw."""
    budget = config.getoption("--drawn")
    if budget is None:
        return "drawn: nothing, every selected case runs"
    return (
        f"drawn: costly files for {budget:g} s, near a change first, then by the seed {seed()}"
        " (DQFORGE_SEED repeats it)"
    )


if __name__ == "__main__":
    number, names = int(sys.argv[1]), sys.argv[2:]
    sys.stdout.write("".join(f"{name}\n" for name in sorted(names, key=turn)[:number]))
