"""The vendors' own importers: tried where they are installed (`make importers`), always in CI."""

from __future__ import annotations

import importlib
import os
from typing import Any

import pytest


def importer(name: str) -> Any:
    """A module of an importer; its test is left out where it is not installed, but not in CI."""
    if os.environ.get("DQFORGE_IMPORTERS"):
        return importlib.import_module(name)
    return pytest.importorskip(name)
