"""Processes that end while they start are called that."""

from __future__ import annotations

from types import SimpleNamespace

import distributed
import pytest
from distributed.comm.core import CommClosedError

from dqforge.reports.exploration.local_cluster import EngineStoppedError, local_workers


def cluster(**_: object) -> SimpleNamespace:
    return SimpleNamespace(workers={}, close=lambda **_: None, status="running")


def client(*_: object, **__: object) -> SimpleNamespace:
    return SimpleNamespace(close=lambda **_: None, status="running")


def lost(*_: object, **__: object) -> None:
    raise OSError("Timed out trying to connect to tcp://127.0.0.1:40001")


@pytest.mark.parametrize("during", ["start", "work"])
def test_a_worker_that_ends_early_is_no_matter_of_disks(
    during: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(distributed, "LocalCluster", cluster)
    monkeypatch.setattr(distributed, "Client", lost if during == "start" else client)
    says = r"one of 3 processes ended while it started or answered \(\w+\); .*fewer --workers$"
    with pytest.raises(EngineStoppedError, match=says), local_workers(3):
        raise CommClosedError("in <TCP>: Stream is closed")
