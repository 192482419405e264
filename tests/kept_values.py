"""What the functions of physics return while a case runs, and what their variables then hold: a
number for each, in short.

A function is followed through its first calls. Every number in what it returns counts with a weight
of its own place and by its logarithm, so that a share of a small number is seen beside a large one;
arrays count by their largest entry and two weighted sums, over entries evenly drawn where they are
large, balls by their radius too. So do numbers and arrays among arguments, variables and, as an
object is made, its attributes: a start or a step that a search, a limit or a sum over both signs
hides from those who call is seen within. What differs between two sets of kernels of the linear
algebra, as what is left of a residual, is not kept.
"""

from __future__ import annotations

import base64
import dataclasses
import hashlib
import importlib
import itertools
import math
import re
import sys
import zlib
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from fractions import Fraction
from functools import cache
from types import CodeType, FrameType
from typing import Any

import house
import numpy as np

PHYSICS = r"optimizer/|machines/(\w+_machines|losses|modulation|plants|transforms|back_emf)"
ROOT = f"{house.ROOT}/"
CALLS, LEAVES, LETTERS = 40, 5000, 4
# Of variables: through so many calls, so many numbers each.
CALLS_WITHIN, LEAVES_WITHIN = 12, 200
# Below the first, a number counts as nothing; within the second, sums are the same, and those that
# are kept are so with other kernels within a tenth of it.
NOTHING, WITHIN = 1e-12, 2e-4
SMALL = 1e-6  # of the largest entry of an array
WEIGHTS = 0.5 + np.random.default_rng(7).random(4096)
NONE, NAN, INFINITE = 2.0, 77.0, 88.0
# By file and function.
Sums = Mapping[tuple[str, str], float]


def _by_logarithm(number: Any) -> float:
    if abs(number) < NOTHING:
        return 0.0
    if isinstance(number, float) and not math.isfinite(number):
        return NAN if math.isnan(number) else math.copysign(INFINITE, number)
    above, below = abs(number).as_integer_ratio()
    size = math.log(above) - math.log(below) - math.log(NOTHING)
    return size if number > 0 else -size


def _of_array(array: np.ndarray[Any, Any]) -> tuple[float, ...]:
    parts = 2 if array.dtype.kind == "c" else 1
    numbers = array.ravel()[:: 1 + parts * array.size // WEIGHTS.size]
    if parts > 1:
        numbers = np.concatenate([numbers.real, numbers.imag])
    numbers, weights, strange = numbers.astype(float), WEIGHTS[: numbers.size], 0.0
    finite = np.isfinite(numbers)
    if not finite.all():
        ends = np.where(np.isnan(numbers), NAN, np.sign(numbers) * INFINITE)
        strange = float(weights @ np.where(finite, 0.0, ends))
        numbers = np.where(finite, numbers, 0.0)
    most = np.abs(numbers).max(initial=NOTHING)
    shares = numbers / most
    sums = (float(weights @ each) for each in (shares, np.arcsinh(shares / SMALL)))
    return array.size, _by_logarithm(float(most)), strange, *sums


def _of_one(thing: object) -> tuple[float, ...]:
    """Numbers for what is no collection: none for what is no number, a sentence, or a function."""
    found: tuple[float, ...] = ()
    match thing:
        case None:
            found = (NONE,)
        case bool() | np.bool_():
            found = (1.0 if thing else -1.0,)
        case int() | float() | Fraction() | np.integer() | np.floating():
            found = (_by_logarithm(thing if isinstance(thing, (int, Fraction)) else float(thing)),)
        case complex() | np.complexfloating():
            found = _of_array(np.array(thing))
        case np.ndarray() if thing.dtype.kind in "biufc":
            found = _of_array(thing)
        case _ if type(thing).__module__.startswith("flint"):
            found = tuple(_of_exact(thing))
        case str() if thing.isidentifier():
            found = (float(zlib.crc32(thing.encode()) % 997),)
    return found


def _of_exact(thing: Any) -> Iterator[float]:
    """Numbers for a rational number, a ball with its radius, or a matrix of them."""
    if hasattr(thing, "entries"):
        for entry in thing.entries():
            yield from _of_exact(entry)
    elif hasattr(thing, "rad"):
        yield from (_by_logarithm(float(part)) for part in (thing.mid(), thing.rad()))
    elif hasattr(thing, "denom"):
        yield _by_logarithm(Fraction(int(thing.numer()), int(thing.denom())))


def _within(frame: FrameType) -> Iterator[float]:
    """Numbers that the variables of a function hold, alone or in a sequence, and the attributes of
    what it makes.
    """
    held = frame.f_locals
    if frame.f_code.co_name == "__init__":
        held = held | getattr(held.get("self"), "__dict__", {})
    for name, thing in held.items():
        if name in ("self", "cls") or isinstance(thing, str):
            continue
        things = thing if isinstance(thing, (tuple, list)) else (thing,)
        for one in things[:LEAVES_WITHIN]:
            yield from _of_one(one)


def _leaves(value: object) -> Iterator[float]:
    """Numbers within a value, those of arrays in short."""
    stack = [value]
    known: set[int] = set()
    while stack:
        match thing := stack.pop():
            case tuple() | list():
                stack.extend(reversed(thing))
            case dict():
                stack.extend(reversed(thing.values()))
            case _ if dataclasses.is_dataclass(thing):
                names = reversed([field.name for field in dataclasses.fields(thing)])
                stack.extend(getattr(thing, name, None) for name in names if id(thing) not in known)
                known.add(id(thing))
            case _:
                yield from _of_one(thing)


class Record:
    """Sums over what functions of physics find, in the order of their first return."""

    def __init__(self) -> None:
        self.sums: dict[tuple[str, str], float] = {}
        self._leaves: dict[tuple[str, str], int] = defaultdict(int)
        self._calls: dict[CodeType, int] = {}
        self._physics = re.compile(PHYSICS)

    def _first(self, code: CodeType) -> int:
        """Calls of a function that count, as it is first called."""
        # Bodies of classes run where modules load, comprehensions within what is followed.
        own = code.co_flags & 1 and not code.co_name.startswith("<")
        path = code.co_filename
        physics = path.startswith(ROOT) and self._physics.match(path.removeprefix(ROOT))
        return CALLS if own and physics else 0

    def _follower(self) -> Callable[[FrameType, str, object], Any]:
        """What is asked at every call, of anything."""
        calls, first, returned = self._calls, self._first, self._returned

        def called(frame: FrameType, _event: str, _value: object) -> Any:
            code = frame.f_code
            left = calls.get(code)
            if left is None:
                left = calls[code] = first(code)
            if not left:
                return None
            calls[code] = left - 1
            frame.f_trace_lines = False
            return returned

        return called

    def _returned(self, frame: FrameType, event: str, value: object) -> Any:
        if event == "return":
            key = frame.f_code.co_filename.removeprefix(ROOT), frame.f_code.co_qualname
            total, number = self.sums.get(key, 0.0), self._leaves[key]
            leaves: Iterator[float] = itertools.islice(_leaves(value), LEAVES)
            if self._calls[frame.f_code] >= CALLS - CALLS_WITHIN:
                leaves = itertools.chain(leaves, _within(frame))
            for leaf in leaves:
                number += 1
                total += leaf * WEIGHTS[number % WEIGHTS.size]
            self.sums[key], self._leaves[key] = float(total), number
        return self._returned

    def of(self, case: Callable[[], object]) -> Any:
        """Run a case, with nothing at hand that earlier ones have solved; give what it gives."""
        forget()
        with _followed_by(self._follower()):
            return case()


@contextmanager
def _followed_by(called: Any) -> Iterator[None]:
    before = sys.gettrace()
    sys.settrace(called)
    try:
        yield
    finally:
        sys.settrace(before)


def unseen() -> AbstractContextManager[None]:
    """What runs meanwhile, as a module that loads, is not recorded: it does so once."""
    return _followed_by(None)


def forget() -> None:
    """Load the whole product, and empty what functions of it and of the tests have kept of earlier
    calls.
    """
    for name in house.modules():
        importlib.import_module(f"dqforge.{name}")
    for module in list(sys.modules.values()):
        file = str(getattr(module, "__file__", ""))
        if file.startswith(ROOT) and "site-packages" not in file:
            for thing in list(vars(module).values()):
                inner = vars(thing).values() if isinstance(thing, type) else ()
                for one in (thing, *inner):
                    method = getattr(one, "__func__", one)
                    if isinstance(method, type(functions)):
                        method.cache_clear()


def in_short(words: str, letters: int = LETTERS) -> str:
    """Some letters for words."""
    return base64.b64encode(hashlib.sha256(words.encode()).digest()).decode()[:letters]


def kept_form(sums: Sums, other: Sums, earlier: Iterable[Mapping[str, str]]) -> dict[str, str]:
    """What is kept of sums, by file: what ``other`` kernels give too and no ``earlier`` case has
    already.
    """
    had = {
        (path, letters, number)
        for kept in earlier
        for path, line in kept.items()
        for letters, number in _pairs(line)
    }
    found: dict[str, list[str]] = defaultdict(list)
    for (path, name), total in sums.items():
        one = in_short(name), f"{total:.4f}"
        same = abs(other.get((path, name), math.inf) - total) <= 0.1 * WITHIN
        if same and total and (path, *one) not in had:
            found[path] += one
    return {path: " ".join(words) for path, words in sorted(found.items())}


def _pairs(line: str) -> Iterator[tuple[str, str]]:
    words = line.split()
    return zip(words[::2], words[1::2], strict=True)


@cache
def functions(path: str) -> dict[str, str]:
    """The names of the functions of a file by their letters."""
    return {in_short(code.co_qualname): code.co_qualname for code in _codes(path)}


def _codes(path: str) -> list[CodeType]:
    """The code of a file and of all functions in it, outer ones first."""
    codes = [compile((house.ROOT / path).read_text(encoding="utf-8"), path, "exec")]
    for code in codes:
        codes += [inner for inner in code.co_consts if isinstance(inner, CodeType)]
    return codes


def around(path: str, line: int) -> list[str]:
    """The functions around a line of a file, by their names."""
    found = []
    for code in _codes(path):
        lines = [code.co_firstlineno, *(one for *_, one in code.co_lines() if one)]
        if min(lines) <= line <= max(lines):
            found.append(code.co_qualname)
    return found


def differences(record: Record, kept: Mapping[str, str]) -> Iterator[str]:
    """Functions that find something else than what was kept, in the order of their first return,
    and those that do not run any more; not those that are new or gone.
    """
    was = {(path, one): float(x) for path, line in kept.items() for one, x in _pairs(line)}
    for (path, name), total in record.sums.items():
        before = was.pop((path, in_short(name)), None)
        if before is not None and abs(total - before) > WITHIN:
            yield f"{path}: {name} finds something else: {before:.4f} is now {total:.4f}"
    for path, letters in was:
        gone = functions(path).get(letters) if (house.ROOT / path).is_file() else None
        if gone is not None:
            yield f"{path}: {gone} is no longer called"
