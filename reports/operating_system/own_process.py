"""What a process of dqforge spends beside its work: threads of linear algebra, and the search for
garbage.
"""

from __future__ import annotations

import gc
import os

_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")

_OBJECTS = 100_000


def prepare_process() -> None:
    """One thread of linear algebra, unless the environment says how many: the matrices are small,
    threads wait for each other, and sums by several threads are other sums. It counts where numpy
    is not loaded yet.

    Cycles of objects are looked for seldom: what is imported and drawn is looked through each time,
    which took a tenth of a run, and next to nothing of it goes.
    """
    for name in _THREADS:
        os.environ.setdefault(name, "1")
    gc.set_threshold(_OBJECTS, 50, 50)
