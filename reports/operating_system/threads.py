"""How many threads libraries of linear algebra may take."""

from __future__ import annotations

import os

_NAMES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def one_thread() -> None:
    """One thread of linear algebra per process, unless the environment says how many: the matrices
    are small, threads wait for each other, and sums by several threads are other sums.

    It counts where numpy is not loaded yet.
    """
    for name in _NAMES:
        os.environ.setdefault(name, "1")
