"""What every test of the engine starts from."""

from __future__ import annotations

import signal
from collections.abc import Iterator

import pytest


@pytest.fixture(autouse=True)
def _heard_interrupts() -> Iterator[None]:
    """Ctrl-C as a terminal gives it: what runs in the background may have been told not to hear."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)
