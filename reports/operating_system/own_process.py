"""What a process of dqforge spends beside its work: threads of linear algebra, the search for
garbage, and help on classes that nobody reads.
"""

from __future__ import annotations

import gc
import os

_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")

_OBJECTS = 100_000

_HELP = "_update_set_signature_and_docstring"


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


def prepare_drawing() -> None:
    """Artists of matplotlib without the help on ``set`` that it writes for each of a hundred
    classes when it is loaded, which takes half of that time.
    """
    from matplotlib.artist import Artist

    if hasattr(Artist, _HELP):
        setattr(Artist, _HELP, classmethod(_without_help))


def _without_help(_class: type) -> None:
    pass
