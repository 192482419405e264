"""Which tests come to a function by its name: read from the source, nearest first.

A function, a method or a name that a module sets uses the names in its body; from the changed one
the way goes to what uses its name, in modules that import it, and on to the cases of tests. What
is called by way of a table is found where the table stands; what many classes name alike is found
too often, so that this says an order and leaves nothing out.
"""

from __future__ import annotations

import ast
import math
import re
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path

import house

# Where and what: a module, a file of tests or a template, and a function or name in it.
Place = tuple[str, str]
WORD = re.compile(r"[A-Za-z][\w-]{2,}")
TEMPLATE = re.compile(r"\w+\.[ch]\b")


def _used(nodes: Iterable[ast.AST]) -> set[str]:
    """Every name in the bodies, with the templates that their texts name."""
    names = set()
    for outer in nodes:
        for node in ast.walk(outer):
            match node:
                case ast.Name(id=name) | ast.Attribute(attr=name) | ast.arg(arg=name):
                    names.add(name)
                case ast.Constant(value=str() as text):
                    names |= set(TEMPLATE.findall(text))
    return names


def _named(node: ast.stmt, within: str = "") -> Iterator[tuple[str, set[str]]]:
    """What a statement of a module or class defines, with what it uses."""
    match node:
        case ast.ClassDef(name=name, body=body):
            for inner in body:
                yield from _named(inner, name)
        case ast.FunctionDef(name=name):
            # An operation or the making of an object is met under the name of the class.
            yield within if within and name.startswith("__") else name, _used([node])
        case ast.Assign(targets=targets):
            for name in _used(targets):
                yield within or name, _used([node])
        case ast.AnnAssign(target=target):
            for name in _used([target]):
                yield within or name, _used([node])
        case _:
            yield within, _used([node])


@cache
def _words(test: str) -> frozenset[str]:
    """Every word in a file of tests."""
    return frozenset(WORD.findall((house.ROOT / test).read_text(encoding="utf-8")))


@cache
def _weights() -> dict[str, float]:
    """How much a word says of a file of tests: much where few have it."""
    known = Counter(word for test in house.tests() for word in _words(test))
    return {word: math.log(len(house.tests()) / count) for word, count in known.items()}


def alike(text: str, test: str) -> float:
    """How much the words of a piece of source say of a file of tests."""
    return sum(_weights()[word] for word in _words(test).intersection(WORD.findall(text)))


@cache
def users() -> dict[str, set[Place]]:
    """Where each name is used, in the package, its templates and its tests."""
    found: dict[str, set[Place]] = defaultdict(set)
    files = dict(house.modules())
    for path in (house.ROOT / "tests").rglob("*.py"):
        files[path.relative_to(house.ROOT).as_posix()] = path
    for where, path in files.items():
        for statement in house.parsed(path).body:
            for name, used in _named(statement):
                for other in used - {name}:
                    found[other].add((where, name))
    for path in (house.ROOT / "reports").rglob("*.[ch].j2"):
        name = path.name.removesuffix(".j2")
        for other in set(TEMPLATE.findall(path.read_text(encoding="utf-8"))) - {name}:
            found[other].add((path.name, name))
    return found


def _changed(path: str, line: int) -> str:
    """The name under which what stands in a line of a file is used."""
    if path.endswith(".j2"):
        return Path(path).name.removesuffix(".j2")
    for statement in house.parsed(house.ROOT / path).body:
        inner = statement.body if isinstance(statement, ast.ClassDef) else [statement]
        for node in inner:
            if node.lineno <= line <= (node.end_lineno or line):
                within = statement.name if isinstance(statement, ast.ClassDef) else ""
                return next(iter(_named(node, within)), ("", set()))[0]
    return ""


def cases(path: str, line: int, reached: set[str]) -> dict[str, int]:
    """Functions of tests, as pytest names them, that come to what stands in a line; with the number
    of steps. ``reached`` are the modules that load it, over whatever others.
    """
    name = _changed(path, line)
    steps = {name: 0}
    wave = [name]
    found: dict[str, int] = {}
    while wave:
        coming = []
        for used in wave:
            for where, user in users().get(used, ()):
                if where.startswith("tests/"):
                    if user.startswith("test_"):
                        found.setdefault(f"{where}::{user}", steps[used])
                        continue
                elif where not in reached and not where.endswith(".j2"):
                    continue
                if user and user not in steps:
                    steps[user] = steps[used] + 1
                    coming.append(user)
        wave = coming
    return found
