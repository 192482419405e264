"""Which of the costly cases a run takes: drawn anew for each commit, within a given time.

`tests/costs.json` keeps the seconds of every case that takes long; what is not listed there is
cheap, and always runs. ``--drawn 60`` fills 60 s of processor time with costly
cases in an order that the commit gives, so that every case has its turn; without the option all of
them run. ``--keep-costs`` writes the file anew from what a run without the option took.

As a program, ``python tests/drawn_cases.py 2 NAME...`` prints the two names whose turn it is.
"""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
import sys
from collections import defaultdict
from functools import cache
from pathlib import Path
from typing import Any

import pytest

HERE = Path(__file__).parent
COSTS = HERE / "costs.json"
COSTLY_S = 0.2
# What a case of the campaign is taken to cost before it was first measured.
UNKNOWN_S = 3.0


@cache
def seed() -> str:
    """The commit that is tested, or what ``DQFORGE_SEED`` says."""
    asked = os.environ.get("DQFORGE_SEED")
    if asked:
        return asked
    found = subprocess.run(
        ["git", "rev-parse", "--short=12", "HEAD"],
        cwd=HERE,
        capture_output=True,
        text=True,
        check=False,
    )
    return found.stdout.strip() or "no commit"


def turn(name: str) -> str:
    """Place of a case in the order of this commit."""
    return hashlib.sha256(f"{seed()} {name}".encode()).hexdigest()


def function_of(name: str) -> str:
    """The test function of a case."""
    return name.partition("[")[0]


def kept_costs() -> dict[str, float]:
    """Seconds of every case that takes long, by its name."""
    found: dict[str, float] = json.loads(COSTS.read_text(encoding="utf-8"))
    return found


def cost_of(item: pytest.Item, costs: dict[str, float]) -> float:
    """Seconds that a case is expected to take; 0 where it is cheap."""
    known = costs.get(item.nodeid)
    if known is not None:
        return known
    return UNKNOWN_S if item.get_closest_marker("slow") else 0.0


def drawn(items: list[pytest.Item], budget: float, costs: dict[str, float]) -> list[pytest.Item]:
    """The cheap cases, and of the costly ones those whose turn it is, as long as seconds are left.

    Their order is that of ``items``.
    """
    left, kept = budget, set()
    for item in sorted(items, key=lambda item: turn(item.nodeid)):
        cost = cost_of(item, costs)
        if cost <= left or cost == 0.0:
            kept.add(item.nodeid)
            left -= cost
    return [item for item in items if item.nodeid in kept]


class Costs:
    """Collects what cases take, and keeps it; one that ran in several parts counts as their sum."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = defaultdict(float)

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Add one part of a case: its setup, itself, or its end."""
        self.seconds[report.nodeid] += report.duration

    def pytest_sessionfinish(self) -> None:
        """Write what the costly cases took; those that did not run keep what they had."""
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
        help="of the costly cases only so many, drawn anew for each commit",
    )
    parser.addoption("--keep-costs", action="store_true", help="write tests/costs.json anew")


def configure(config: pytest.Config) -> None:
    """Count seconds where they are to be kept: in the process that hears of every case."""
    if config.getoption("--keep-costs") and not hasattr(config, "workerinput"):
        config.pluginmanager.register(Costs())


def leave_out(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Take the costly cases out whose turn it is not."""
    budget: Any = config.getoption("--drawn")
    if budget is None:
        return
    kept = drawn(items, budget, kept_costs())
    config.hook.pytest_deselected(items=[item for item in items if item not in set(kept)])
    items[:] = kept


def headline(config: pytest.Config) -> str:
    """What a run says of the draw."""
    budget = config.getoption("--drawn")
    if budget is None:
        return "drawn: nothing, every selected case runs"
    return f"drawn: costly cases for {budget:g} s by the seed {seed()} (DQFORGE_SEED repeats it)"


if __name__ == "__main__":
    number, names = int(sys.argv[1]), sys.argv[2:]
    sys.stdout.write("".join(f"{name}\n" for name in sorted(names, key=turn)[:number]))
