"""Which operating system this is, and what of it is counted."""

from __future__ import annotations

import codecs
import gc
import io
import os
import platform
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType

WINDOWS = os.name == "nt"

LINUX = sys.platform == "linux"

MACOS = sys.platform == "darwin"


def c_source(name: str) -> str:
    """The text of a program in C that lies beside this module."""
    return (Path(__file__).parent / "templates" / name).read_text(encoding="utf-8")


def processors() -> int:
    """Processors that this process may use: those that it is bound to where the system says so."""
    bound = getattr(os, "sched_getaffinity", None)
    return max(1, len(bound(0)) if bound is not None else os.cpu_count() or 1)


# What a process of dqforge runs on: threads and kernels of linear algebra, the search for garbage,
# and help on classes that nobody reads.

_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
KERNEL = "OPENBLAS_CORETYPE"  # Environment variable that names the kernels of the linear algebra.

# Those that every 64-bit processor of a kind can run. On matrices of this size they are as fast as
# the widest ones.
_KERNELS = {"x86_64": "Prescott", "amd64": "Prescott", "aarch64": "ARMV8", "arm64": "ARMV8"}

# Instructions that some x86 processors have, by numpy's names.
_WIDE = "X86_V3 X86_V4 AVX512_ICL AVX512_SPR"
_OBJECTS = 100_000
_HELP = "_update_set_signature_and_docstring"


def fix_kernels() -> None:
    """Let numpy and its linear algebra sum in one order on every processor of a kind, whatever the
    environment says, so that the last digits are the same.

    It counts where numpy is not loaded yet; where it is, the environment stays as it is.
    """
    machine = platform.machine().lower()
    if "numpy" in sys.modules or machine not in _KERNELS:
        return
    os.environ[KERNEL] = _KERNELS[machine]
    if _KERNELS[machine] == "Prescott":
        os.environ["NPY_DISABLE_CPU_FEATURES"] = _WIDE


def prepare_process() -> None:
    """One thread of linear algebra, unless the environment says how many: the matrices are small,
    threads wait for each other, and sums by several threads are other sums. It counts where numpy
    is not loaded yet. The same kernels on every processor (`fix_kernels`).

    Cycles of objects are looked for seldom: what is imported and drawn is looked through each time,
    which took a tenth of a run, and next to nothing of it goes.
    """
    for name in _THREADS:
        os.environ.setdefault(name, "1")
    fix_kernels()
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


# Signals that ask a process to end.

ENDING = (signal.SIGINT, signal.SIGTERM)


@contextmanager
def undisturbed() -> Iterator[None]:
    """Have what asks the process to end wait until the block is over."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    came: list[int] = []
    before = {number: signal.getsignal(number) for number in ENDING}
    heard = {number: old for number, old in before.items() if old not in {signal.SIG_IGN, None}}
    for number in heard:
        signal.signal(number, lambda number, _frame: came.append(number))
    try:
        yield
    finally:
        for number, old in heard.items():
            signal.signal(number, old)
        for first in came[:1]:
            signal.raise_signal(first)


@contextmanager
def asked_to_end() -> Iterator[list[int]]:
    """Let SIGTERM end a command as Ctrl-C does, with what it began cleared up; which signals came.

    Who ignores it, or has an answer of their own, keeps that. What a library that they cut off
    makes of them is an interrupt, too.
    """
    asked: list[int] = []

    def end(number: int, _frame: object) -> None:
        signal.signal(number, signal.SIG_IGN)  # once: what clears up is not disturbed again
        asked.append(number)
        raise KeyboardInterrupt

    def interrupt(number: int, frame: FrameType | None) -> None:
        asked.append(number)
        signal.default_int_handler(number, frame)

    here = threading.current_thread() is threading.main_thread()
    if not here or signal.getsignal(signal.SIGTERM) is not signal.SIG_DFL:
        yield asked
        return
    usual = sys.unraisablehook

    def lost(report: sys.UnraisableHookArgs) -> None:
        # it came while an object was destroyed, where nothing can be raised: once more, soon
        if not isinstance(report.exc_value, KeyboardInterrupt) or WINDOWS:
            usual(report)
            return
        signal.signal(signal.SIGALRM, lambda *_: signal.raise_signal(signal.SIGINT))
        signal.setitimer(signal.ITIMER_REAL, 0.01)

    signal.signal(signal.SIGTERM, end)
    usually = signal.getsignal(signal.SIGINT)
    if usually is signal.default_int_handler:
        signal.signal(signal.SIGINT, interrupt)
    sys.unraisablehook = lost
    try:
        yield asked
    except Exception:
        if asked:
            raise KeyboardInterrupt from None
        raise
    finally:
        sys.unraisablehook = usual
        if usually is signal.default_int_handler:
            signal.signal(signal.SIGINT, usually)
        if not WINDOWS and signal.getitimer(signal.ITIMER_REAL)[0]:
            signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGTERM, signal.SIG_DFL)


# Text on streams that do not know every character: signs of the field are spelled out.
#
# A pipe on Windows, or a terminal of the C locale, takes no psi and no degree; what is printed
# there is ``psi`` and ``deg``, and a question mark for what has no spelling. Files are always
# UTF-8.

_HANDLER = "dqforge-spelled"

_SPELLINGS = {
    **dict(zip("°²³·¹⁻→√⋅−…×≤≥±–—", (
        "deg", "^2", "^3", "*", "^1", "^-", "->", "sqrt", "*", "-", "...", "x", "<=", ">=", "+-",
        "-", "-",
    ), strict=True)),
    **dict(zip("αβγδεζηθϑικλξπρσςτφϕχψωΔΘΛΠΣΦΨΩΩ", (
        "alpha", "beta", "gamma", "delta", "epsilon", "zeta", "eta", "theta", "theta", "iota",
        "kappa", "lambda", "xi", "pi", "rho", "sigma", "sigma", "tau", "phi", "phi", "chi", "psi",
        "omega", "Delta", "Theta", "Lambda", "Pi", "Sigma", "Phi", "Psi", "Ohm", "Ohm",
    ), strict=True)),
    "µ": "u",
    "μ": "u",
}  # fmt: skip


def _spelled(error: UnicodeError) -> tuple[str | bytes, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    sign = error.object[error.start]
    if "\udc80" <= sign <= "\udcff":  # a byte of a file's name that is no text
        return bytes((ord(sign) - 0xDC00,)), error.start + 1
    return _SPELLINGS.get(sign, "?"), error.start + 1


def spell_out() -> None:
    """Have stdout and stderr spell out what they cannot show; a way that somebody chose by
    ``PYTHONIOENCODING`` stays.
    """
    codecs.register_error(_HANDLER, _spelled)
    for stream in (sys.stdout, sys.stderr):
        usual = ("strict", "surrogateescape", "backslashreplace")
        if isinstance(stream, io.TextIOWrapper) and stream.errors in usual:
            stream.reconfigure(errors=_HANDLER)
