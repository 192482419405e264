"""The draw: what is cheap runs always, of the rest what is near and then whose turn it is."""

from __future__ import annotations

import drawn_cases
import pytest

COSTS = {f"tests/machines/test_{name}.py": 2.0 for name in "abcdefgh"}


@pytest.fixture(autouse=True)
def far(monkeypatch: pytest.MonkeyPatch) -> None:
    """A tree in which nothing has changed."""
    monkeypatch.setattr(drawn_cases, "changed_rooms", frozenset)


def test_seconds_are_filled_and_cheap_ones_cost_none() -> None:
    kept = drawn_cases.filling(7.0, {**COSTS, "tests/test_cheap.py": 0.0})
    assert len(kept) == 4
    assert "tests/test_cheap.py" in kept


def test_every_one_has_its_turn(monkeypatch: pytest.MonkeyPatch) -> None:
    drawn = set()
    for seed in range(60):
        monkeypatch.setattr(drawn_cases, "seed", lambda seed=seed: str(seed))
        drawn |= drawn_cases.filling(2.0, COSTS)
    assert drawn == set(COSTS)


def test_what_is_near_comes_first(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(drawn_cases, "changed_rooms", lambda: {"optimizer/loops"})
    near = "tests/optimizer/loops/test_gains.py"
    assert drawn_cases.filling(2.0, {**COSTS, near: 2.0}) == {near}


def test_the_rules_of_the_house_run_always() -> None:
    ruled = dict.fromkeys(drawn_cases.ALWAYS, 9.0)
    assert drawn_cases.filling(0.0, {**COSTS, **ruled}) == set(ruled)
    assert drawn_cases.filling(0.0, COSTS, ["tests/machines/test_a"]) == {
        "tests/machines/test_a.py"
    }


def test_kept_costs_and_what_runs_always_are_of_files_that_are_there() -> None:
    names = [name.partition("::")[0] for name in drawn_cases.kept_costs()]
    root = drawn_cases.HERE.parent
    assert [name for name in (*names, *drawn_cases.ALWAYS) if not (root / name).is_file()] == []


def test_files_are_passed_over_only_where_none_of_their_cases_would_run(
    request: pytest.FixtureRequest,
) -> None:
    root = request.config.rootpath
    asked = pytest.Config.fromdictargs(
        {"drawn": 0.0, "markexpr": "not slow and not benchmark"}, [str(root / "tests")]
    )
    passed_over = drawn_cases.needless_files(asked)
    assert root / "tests/benchmarks/test_start.py" in passed_over
    assert root / "tests/test_cli.py" in passed_over
    assert root / "tests/test_house.py" not in passed_over
    asked.option.markexpr = "slow"
    assert not drawn_cases.needless_files(asked)
    asked.option.markexpr, asked.option.drawn = "not slow and not benchmark", None
    assert not drawn_cases.needless_files(asked)
