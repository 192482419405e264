"""What a process leaves out when it loads libraries."""

from __future__ import annotations

import subprocess
import sys

LOADED = """
import sys
{before}
import numpy as np
import scipy.fft, scipy.interpolate, scipy.ndimage, scipy.signal, scipy.spatial, scipy.stats
from scipy.optimize import linprog
words = sum(len(getattr(scipy.fft, name).__doc__ or "") for name in ("fft", "fft2", "fftn"))
found = linprog([1.0, 2.0], A_ub=[[-1.0, -1.0]], b_ub=[-3.0])
print(words, [type(each).__name__ for each in sys.meta_path].count("_Unread"), found.x.tolist())
"""
PREPARED = (
    "from dqforge.reports.operating_system.system import prepare_process as prepare; "
    "prepare(); prepare()"
)


def loaded(before: str) -> list[str]:
    """Length of some help, finders that are left, and an answer, from a process of its own."""
    command = [sys.executable, "-c", LOADED.format(before=before)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    return done.stdout.split(maxsplit=2)


def test_scipy_is_whole_but_for_the_help_that_it_would_write_again() -> None:
    plain, prepared = loaded(""), loaded(PREPARED)
    assert int(prepared[0]) < 0.5 * int(plain[0])
    assert prepared[1] == "0"
    assert prepared[2] == plain[2] == "[3.0, 0.0]\n"
