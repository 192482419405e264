"""Shared fixtures: the reference drives in SI numbers and the folder of data made by others."""

from __future__ import annotations

import gc
import os
import signal
from pathlib import Path

import drawn_cases
import pytest
from hypothesis import settings

from dqforge.reports.operating_system.system import fix_kernels

# As in a process of dqforge, before numpy is there.
fix_kernels()

from dqforge.machines.dq_machines.synchronous import LinearMachine  # noqa: E402

# No test may depend on the speed of the machine; in CI every run tries the same examples.
settings.register_profile("dqforge", deadline=None, derandomize=bool(os.environ.get("CI")))
settings.load_profile("dqforge")

# Files that a run with a draw leaves out as a whole.
NEEDLESS = pytest.StashKey[frozenset[Path]]()

REPOSITORY = Path(__file__).resolve().parent.parent

# What is started in the background of a script has Ctrl-C ignored, and hands that down to every
# command that the tests start and interrupt.
signal.signal(signal.SIGINT, signal.default_int_handler)

# Modules and tests that are collected stay to the end: no collector need walk them, then or later.
gc.disable()


def pytest_collection_finish() -> None:
    """Give the garbage collector what the tests make, and nothing of what they are."""
    gc.freeze()
    gc.enable()


def pytest_addoption(parser: pytest.Parser) -> None:
    """Let a run take a part of the costly cases."""
    drawn_cases.add_options(parser)


def pytest_configure(config: pytest.Config) -> None:
    """Measure what cases take, where that is asked for."""
    drawn_cases.configure(config)
    config.pluginmanager.register(_AfterSelection())
    config.stash[NEEDLESS] = drawn_cases.needless_files(config)


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Import no file of which nothing would run."""
    return True if collection_path in config.stash[NEEDLESS] else None


def pytest_report_header(config: pytest.Config) -> str:
    """Say what was drawn, and how to draw it again."""
    return drawn_cases.headline(config)


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Leave all but one case of each thinned test, drawn like the others, to the campaign."""
    cases: dict[str, list[pytest.Item]] = {}
    for item in items:
        if item.get_closest_marker("thinned") is not None:
            cases.setdefault(drawn_cases.function_of(item.nodeid), []).append(item)
    for thinned in cases.values():
        chosen = min(thinned, key=lambda item: drawn_cases.turn(item.nodeid))
        for item in thinned:
            if item is not chosen:
                item.add_marker(pytest.mark.slow)


class _AfterSelection:
    """Draws from what the expression of markers has left over."""

    @pytest.hookimpl(trylast=True)
    def pytest_collection_modifyitems(
        self, config: pytest.Config, items: list[pytest.Item]
    ) -> None:
        drawn_cases.leave_out(config, items)
        counted = tuple(config.getoption("--always"))
        for item in items if counted else ():
            # Counting lines slows all that runs by a fifth, and the proofs alone are counted.
            if not item.nodeid.startswith(counted):
                item.add_marker("no_cover")


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Folder with real files made by others.

    It lies beside the checkout and is no part of the project.
    """
    folder = REPOSITORY.parent / "shared" / "data"
    if not folder.is_dir():
        if os.environ.get("CI"):
            pytest.fail(f"{folder} is missing; CI needs it")
        pytest.skip("shared/data is not beside this checkout")
    return folder


@pytest.fixture(scope="session")
def ipm100() -> LinearMachine:
    """Machine of paper 000 with the values that its Table 2 identifies."""
    return LinearMachine(
        pole_pairs=4,
        r_s=2e-3,
        l_d=350e-6,
        l_q=592e-6,
        psi_pm=0.1049,
        i_max=283.0,
        inertia=0.05,
        omega_m_max=942.478,
    )


@pytest.fixture(scope="session")
def bench001() -> LinearMachine:
    """Machine of paper 001, appendix A."""
    return LinearMachine(
        pole_pairs=3,
        r_s=2.35,
        l_d=1.61e-3,
        l_q=1.74e-3,
        psi_pm=0.06,
        i_max=2.263,
        inertia=200e-6,
        friction=40e-6,
    )
