"""Which operating system this is, and what of it is counted."""

from __future__ import annotations

import os
import sys

WINDOWS = os.name == "nt"

LINUX = sys.platform == "linux"

MACOS = sys.platform == "darwin"


def processors() -> int:
    """Processors that this process may use: those that it is bound to where the system says so."""
    bound = getattr(os, "sched_getaffinity", None)
    return max(1, len(bound(0)) if bound is not None else os.cpu_count() or 1)
