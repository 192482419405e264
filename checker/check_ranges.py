"""Confirms `<prefix>_ranges.json`: that no integer of what runs in fixed point leaves its type.

    python -I -S check_ranges.py abb2k2_ranges.json

The program imports nothing but the standard library and, beside it, `kit.py`, the reader of C
`c_text.py`, and the numbers of `nodes.py`. It calculates in integers and fractions alone. It runs
every function that the certificate names on ranges in place of numbers, and believes nothing: what
the certificate tells of a state must hold again after each call. Read it from top to bottom:
running the C (part 1), the certificate (part 2), and what is confirmed (part 3).
"""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Iterator
from contextlib import suppress
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING or __package__:
    from . import c_text, kit, nodes
else:  # run alone: they lie beside this one
    sys.path.insert(0, str(Path(__file__).resolve().parent))
    import c_text
    import kit
    import nodes

Fault = kit.Fault
LIMITS, STRENGTH, common = c_text.LIMITS, c_text.STRENGTH, c_text.common
Tree = c_text.Tree
Impossible = nodes.Impossible
Node = nodes.Node
Pointer = nodes.Pointer
corners, each, fresh, hull, used = nodes.corners, nodes.each, nodes.fresh, nodes.hull, nodes.used
always, copied, narrow, put = nodes.always, nodes.copied, nodes.narrow, nodes.put


# Part 1. Running the C on ranges.
#
# A condition that ranges do not decide is tried both ways, one run after the other; what the ways
# leave is put together where the function ends. A function without conditions is run in place, so
# that what it makes remembers what it was made of.

MOST_WAYS, MOST_ROUNDS = 20000, 80
NOT = {"<": ">=", "<=": ">", ">": "<=", ">=": "<", "==": "!=", "!=": "=="}


class Run:
    """Runs functions; keeps what it found of each call."""

    def __init__(self, code: Any, cuts: dict[str, int], wraps: list[str]) -> None:
        self.code, self.cuts, self.wraps = code, cuts, wraps
        self.fullest: dict[tuple[str, str], tuple[int, str]] = {}  # by header and type
        self.forking: dict[str, bool] = {}
        self.known: dict[Any, Any] = {}
        self.kept: dict[Any, Any] = {}  # constants
        self.called: set[str] = set()
        self.name, self.row = "", 0
        self.ways: list[bool] = []
        self.way = 0
        self.taken: list[tuple[str, Node, Node]] = []  # conditions of this way
        self.here: dict[str, Any] = {}

    def fault(self, words: str) -> Exception:
        return Fault(f"{self.name}, line {self.row}: {words}")

    # Calls.

    def forks(self, tree: Any) -> bool:
        """Whether a function has conditions of its own."""
        if isinstance(tree, tuple) and tree and tree[0] in ("if", "while", "choice"):
            return True
        return isinstance(tree, list | tuple) and any(map(self.forks, tree))

    def call(self, name: str, given: list[Any]) -> Any:
        """What a function returns; what it changes in records stands there afterwards."""
        if name not in self.code.functions:
            raise self.fault(f"{name} is not known")
        kind, parameters, body, row, _ = self.code.functions[name]
        if len(given) != len(parameters):
            raise self.fault(f"{name} has {len(parameters)} arguments")
        self.called.add(name)
        given = [
            x if pointer or own not in LIMITS else self.converted(x, own)
            for x, (own, _, pointer) in zip(given, parameters)
        ]
        before = (self.name, self.row, self.here, self.ways, self.way, self.taken)
        self.name, self.row = name, row
        try:
            if name not in self.forking:
                self.forking[name] = self.forks(body)
            if before[0] and not self.forking[name] and name not in self.cuts:
                own = [x if y[2] else copied(x) for x, y in zip(given, parameters)]
                return self.once(kind, parameters, body, own)
            key = (name, nodes.spans(given))
            if key not in self.known:
                self.known[key] = self.every(kind, parameters, body, given)
            value, left, bound = self.known[key]
            for x, after, (_, _, pointer) in zip(given, left, parameters):
                if pointer and isinstance(x, dict | list):
                    put(x, after)
            value = each(fresh, value)
            if bound and isinstance(value, Node):
                value.fact = (given[0], bound)
            return value
        finally:
            self.name, self.row, self.here, self.ways, self.way, self.taken = before

    def every(self, kind: str, parameters: Any, body: Tree, given: list[Any]) -> Any:
        """All ways through a function, for all pieces of its first argument."""
        bounds: list[Any] = []

        def once(first: int, after: int) -> tuple[Any, Any]:
            own = each(nodes.given, given)
            if pieces > 1:
                own[0] = Node(first, after - 1, own[0].kind)
            value = self.once(kind, parameters, body, own)
            root = isinstance(value, Node) and own
            bounds.append(nodes.found(nodes.bound_of_root, value, own[0]) if root else None)
            return value, own

        found, pieces = [], self.cuts.get(self.name, 1)
        low, size = (given[0].low, given[0].high - given[0].low + 1) if pieces > 1 else (0, 1)
        for piece in range(pieces):
            first, after = (low + size * (piece + k) // pieces for k in (0, 1))
            if first < after:
                found += self.tried(partial(once, first, after))
        if not found:
            raise Impossible
        bound = None if None in bounds else max(x for x in bounds if x is not None)
        value, left = each(hull, *map(list, found))
        return each(fresh, value), left, bound

    def tried(self, once: Callable[[], Any]) -> list[Any]:
        """What all ways leave."""
        found: list[Any] = []
        ways: list[bool] = []
        while True:
            self.ways, self.way, self.taken = ways, 0, []
            with suppress(Impossible):
                found.append(once())
            while ways and not ways[-1]:
                ways.pop()
            if len(found) > MOST_WAYS:
                raise self.fault("it has too many ways")
            if not ways:
                return found
            ways[-1] = False

    def joined(self, tree: Tree) -> None:
        """A condition within a round of a loop, whose sides are put together at its end: a root of
        so many rounds would have too many ways.
        """
        before = (self.here, self.ways, self.way, self.taken)

        def once() -> dict[str, Any]:
            self.here = each(fresh, before[0])
            self.do(tree)
            return self.here

        found = self.tried(once)
        _, self.ways, self.way, self.taken = before
        if not found:
            raise Impossible
        self.here = each(hull, *found)

    def once(self, kind: str, parameters: Any, body: Tree, given: list[Any]) -> Any:
        """One way through a function."""
        self.here = {"": kind} | {name: x for x, (_, name, _) in zip(given, parameters)}
        found = self.do(body)
        return found[1] if found else None

    # Statements.

    def do(self, tree: Tree) -> tuple[str, Any] | None:
        """Runs a statement; what it returns, if it does."""
        what = tree[0]
        if what == "block":
            for each in tree[1]:
                found = self.do(each)
                if found:
                    return found
            return None
        self.row = tree[1]
        if what == "local":
            _, _, kind, name, many, value, pointer, constant = tree
            if constant and value:
                made = self.kept.get(id(value)) or self.filled(kind, many, value)
                self.kept[id(value)] = made
            elif value is None or value[0] == "list":
                made = self.filled(kind, many, value)
            else:
                made = self.value(value)
                made = made if pointer else self.stored(made, kind)
            self.here[name] = made
        elif what == "set":
            value = self.value(tree[3])
            record, name = self.place(tree[2])
            kind = record[name].kind if isinstance(record[name], Node) else ""
            record[name] = self.stored(value, kind)
        elif what == "if":
            return self.do(tree[3] if self.holds(tree[2]) else tree[4])
        elif what == "while":
            for _ in range(MOST_ROUNDS):
                found = ("end", None) if not self.holds(tree[2]) else self.round(tree[3])
                if found:
                    return found if found[0] == "return" else None
                self.row = tree[1]
            raise self.fault("the loop may not end")
        elif what == "return":
            return ("return", self.stored(self.value(tree[2]), self.here[""]))
        else:
            self.value(tree[2])
        return None

    def round(self, tree: Tree) -> tuple[str, Any] | None:
        """A round of a loop; a condition without another side that only sets numbers is joined."""
        alone = all(
            isinstance(x, str) or getattr(x, "lost", True) == "" for x in self.here.values()
        )
        for part in tree[1]:
            sets = part[0] == "if" and {x[0] for x in part[3][1]} == {"set"}
            if alone and sets and part[4] == ("block", []):
                self.joined(part)
            elif found := self.do(part):
                return found
        return None

    def any(self, kind: str, lost: str = "") -> Any:
        """Every value of a type; ``lost`` says why none may be used."""
        if kind in LIMITS:
            found = Node(*LIMITS[kind], kind)
            found.lost = lost
            return found
        members = self.code.types[kind]
        return {name: self.anything(own, size, lost) for own, name, size in members}

    def anything(self, kind: str, many: tuple[int, ...], lost: str = "") -> Any:
        """As `any`, of an array."""
        if not many:
            return self.any(kind, lost)
        return [self.anything(kind, many[1:], lost) for _ in range(many[0])]

    def filled(self, kind: str, many: tuple[int, ...], value: Tree | None) -> Any:
        """A constant or variable from its list."""
        if value is None:
            lost = str(self.fault("a value is used that may not be set"))
            return self.anything(kind, many, lost)
        if many:
            if value[0] != "list" or len(value[1]) != many[0]:
                raise self.fault(f"a table has not {many[0]} entries")
            return [self.filled(kind, many[1:], item) for item in value[1]]
        if value[0] != "list":
            return self.stored(self.value(value), kind)
        members = self.code.types[kind]
        if len(value[1]) != len(members):
            raise self.fault(f"a constant of {kind} has not {len(members)} members")
        rows = zip(members, value[1])
        return {name: self.filled(own, size, x) for (own, name, size), x in rows}

    def stored(self, value: Any, kind: str) -> Any:
        """A value as a variable holds it."""
        if not isinstance(value, Node):
            return copied(value)
        return value if value.lost else self.converted(value, kind)

    def place(self, tree: Tree) -> tuple[Any, Any]:
        """Where an assignment goes: the record or array, and the member."""
        if tree[0] == "name" and tree[1] in self.here:
            return self.here, tree[1]
        if tree[0] in ("member", "index"):
            record, name = self.place(tree[1])
            if tree[0] == "member":
                return record[name], tree[2]
            index = self.value(tree[2])
            if index.low == index.high and 0 <= index.low < len(record[name]):
                return record[name], index.low
            raise self.fault(f"the index {index.low} to {index.high} is not one place of the array")
        raise self.fault("an assignment is not understood")

    # Conditions.

    def holds(self, tree: Tree) -> bool:
        """Whether a condition holds on this way; then ranges are narrowed to that."""
        if tree[0] == "one" and tree[1] == "!":
            return not self.holds(tree[2])
        if tree[0] == "two" and tree[1] in ("&&", "||"):
            first = self.holds(tree[2])
            return self.holds(tree[3]) if first == (tree[1] == "&&") else first
        if tree[0] == "two" and STRENGTH[tree[1]] in (6, 7):
            a, b, sign = self.value(tree[2]), self.value(tree[3]), tree[1]
        else:
            a, b, sign = self.value(tree), Node(0, 0, "int32_t"), "!="
        if sign == "==" and a.op == "cut" and a.of[0] is b:
            return self.unchanged(a)
        kind = common(a.kind, b.kind)
        a, b = self.converted(a, kind), self.converted(b, kind)
        for truth, way in ((True, sign), (False, NOT[sign])):
            if always(way, a, b):
                return truth
        chosen = self.chosen()
        self.taken.append((sign if chosen else NOT[sign], a, b))
        for _ in range(2):
            for condition in self.taken:
                narrow(*condition)
        return chosen

    def chosen(self) -> bool:
        """The side that this way takes of a condition."""
        if self.way == len(self.ways):
            self.ways.append(True)
        self.way += 1
        return self.ways[self.way - 1]

    def unchanged(self, cut: Node) -> bool:
        """Whether a conversion kept the number, which is asked for: then it is that number."""
        low, high = LIMITS[cut.kind]
        whole = cut.of[0]
        if low <= whole.low and whole.high <= high:
            same = True
        else:
            same = False if whole.low > high or whole.high < low else self.chosen()
        if same:
            whole.narrow(low, high)
            cut.low, cut.high, cut.op, cut.lost = whole.low, whole.high, "same", ""
        return same

    # Values.

    def value(self, tree: Tree) -> Any:
        """What an expression is."""
        match tree:
            case ("number", value, kind):
                return Node(value, value, kind)
            case ("name", name):
                return self.named(name)
            case ("cast", kind, inner):
                wraps = (inner[0] == "name" and inner[1] in self.wraps) or self.name in self.wraps
                return self.cast(self.value(inner), kind, wraps and kind.startswith("u"))
            case ("call", name, given):
                return self.call(name, [self.value(x) for x in given])
            case ("member", inner, name):
                record = self.value(inner)
                if not isinstance(record, dict) or name not in record:
                    raise self.fault(f"there is no member {name}")
                return record[name]
            case ("index", inner, index):
                return self.entry(self.value(inner), self.value(index))
            case ("one", "&", ("index", inner, index)):
                return Pointer(self.value(inner), self.value(index))
            case ("one", "&", inner):
                return self.value(inner)
            case ("one", sign, inner):
                return self.one(sign, self.value(inner))
            case ("choice", ("two", sign, a, b), *both) if STRENGTH[sign] == 7 and both == [b, a]:
                return self.larger(sign, self.value(a), self.value(b))
            case ("choice", condition, first, second):
                return self.value(first if self.holds(condition) else second)
            case ("two", sign, first, second):
                if sign in ("&&", "||") or STRENGTH[sign] in (6, 7):
                    truth = int(self.holds(tree))
                    return Node(truth, truth, "int32_t")
                return self.two(sign, self.value(first), self.value(second))
        raise self.fault("an expression is not understood")

    def larger(self, sign: str, a: Node, b: Node) -> Node:
        """The larger of two numbers, or the smaller: no side need be taken."""
        kind = common(a.kind, b.kind)
        a, b = self.converted(a, kind), self.converted(b, kind)
        for one, other in ((a, b), (b, a)):
            if always("<=", one, other):
                return other if sign[0] == "<" else one
        pick = max if sign[0] == "<" else min
        return Node(pick(a.low, b.low), pick(a.high, b.high), kind)

    def named(self, name: str) -> Any:
        if name in self.here:
            return self.here[name]
        if name not in self.kept:
            if name not in self.code.constants:
                raise self.fault(f"{name} is not known")
            self.kept[name] = self.filled(*[self.code.constants[name][x] for x in (2, 4, 5)])
        return self.kept[name]

    def entry(self, array: Any, index: Node) -> Any:
        """An entry of a table, or what holds all that it may be."""
        if isinstance(array, Pointer):
            array, index = array.array, self.two("+", array.index, index)
        if not isinstance(array, list) or index.low < 0 or index.high >= len(array):
            raise self.fault(f"the index {index.low} to {index.high} leaves the table")
        if index.low == index.high:
            return array[index.low]
        return each(hull, *array[index.low : index.high + 1])

    def converted(self, value: Any, kind: str) -> Any:
        """A value by a type that must hold it."""
        if not isinstance(value, Node) or used(value).kind == kind or not kind:
            return value
        low, high = LIMITS[kind]
        if value.low < low or value.high > high:
            raise self.fault(f"{value.low} to {value.high} is more than {kind} holds")
        return Node(value.low, value.high, kind, "same", (value,))

    def cast(self, value: Node, kind: str, wraps: bool = False) -> Node:
        """A conversion that is written; what it takes off is a fault where it is used."""
        low, high = LIMITS[kind]
        fits = low <= used(value).low and value.high <= high
        bound = None if fits or wraps else nodes.found(nodes.bound_of_product, value)
        if bound is not None:
            value.narrow(-bound, bound)
        if low <= value.low and value.high <= high:
            return Node(value.low, value.high, kind, "same", (value,))
        found = Node(low, high, kind, "cut", (value,))
        found.lost = (
            ""
            if wraps
            else str(self.fault(f"{value.low} to {value.high} is more than {kind} holds"))
        )
        return found

    def one(self, sign: str, a: Node) -> Node:
        a = self.converted(a, common(a.kind))
        if sign != "-":
            raise self.fault(f"'{sign}' is not understood")
        return self.made("neg", -a.high, -a.low, a.kind, (a,))

    def two(self, sign: str, a: Node, b: Node) -> Node:
        """An operation of two numbers."""
        if sign in ("<<", ">>"):
            a, b = self.converted(a, common(a.kind)), self.converted(b, common(b.kind))
            bits = int(a.kind.strip("uint_"))
            if b.low < 0 or b.high >= bits:
                raise self.fault(f"a shift by {b.low} to {b.high} of {bits} bits")
            if sign == "<<" and a.low < 0:
                raise self.fault("a left shift of a negative number")
            ends = corners(a, b, int.__lshift__ if sign == "<<" else int.__rshift__)
            return self.made(sign, min(ends), max(ends), a.kind, (a, b))
        kind, same = common(a.kind, b.kind), a is b
        a = self.converted(a, kind)
        b = a if same else self.converted(b, kind)
        if sign in ("+", "-", "*"):
            ends = corners(a, b, {"+": int.__add__, "-": int.__sub__, "*": int.__mul__}[sign])
            least, most = min(ends), max(ends)
            if sign == "*" and same:
                least = 0 if a.low <= 0 <= a.high else min(a.low**2, a.high**2)
            rest = nodes.found(nodes.bounds_of_rest, sign, a, b)
            if rest is not None:
                least, most = max(least, rest[0]), min(most, rest[1])
            if sign == "-" and any(x == (">=", a, b) for x in self.taken):
                least = max(least, 0)
            return self.made(sign, least, most, kind, (a, b))
        if sign == "/" and b.low > 0:
            ends = corners(a, b, lambda x, y: abs(x) // y * (1 if x > 0 else -1))
            return self.made(sign, min(ends), max(ends), kind, (a, b))
        if sign == "&" and b.low >= 0:
            m = b.low  # in a part of a where higher bits are the same, a mask leaves a range
            size = m + 1 if m & (m + 1) == 0 else m if m & (m - 1) == 0 else 0
            if m == b.high and size and a.low >= 0 and a.low // size == a.high // size:
                return Node(a.low & m, a.high & m, kind)
            return Node(0, b.high if a.low < 0 else min(a.high, b.high), kind)
        raise self.fault(f"'{sign}' of {a.low} to {a.high}, {b.low} to {b.high} is not understood")

    def made(self, op: str, low: int, high: int, kind: str, of: tuple[Node, ...]) -> Node:
        """A result, which must lie in its type; without a sign it takes the remainder."""
        first, last = LIMITS[kind]
        if first == 0 and op == "+" and high > last:  # an angle wraps
            size = last + 1
            whole = low // size != high // size
            return Node(*((first, last) if whole else (low % size, high % size)), kind)
        if low < first or high > last:
            words = {"neg": "the negative", "+": "a sum", "-": "a difference", "*": "a product"}
            raise self.fault(f"{words.get(op, 'a shift')} can reach {low} to {high}, beyond {kind}")
        doubled = op == "*" and of[1].low == of[1].high and of[1].low in (2, 4)
        if op in ("+", "-", "*") and first and not doubled:
            own = (self.code.functions[self.name][4] if self.name else "", kind)
            if max(-low, high) > self.fullest.get(own, (0, ""))[0]:
                self.fullest[own] = max(-low, high), str(self.fault(f"'{op}'"))
        return Node(low, high, kind, op, of)


# Part 2. The certificate: calls, with what their arguments can be.


class Claims:
    """The calls of a certificate, run one after the other."""

    def __init__(self, stated: dict[str, Any], code: Any) -> None:
        self.stated, self.code = stated, code
        self.run = Run(code, stated["cuts"], stated["wraps"])

    def argument(self, told: Any, kind: str) -> Any:
        """What an argument can be."""
        if isinstance(told, str):
            if told == "any" or told in self.stated["states"]:
                told = {} if told == "any" else self.stated["states"][told]
                return self.argument(told, kind)
            value, *members = told.split(".")
            value = self.run.named(value)
            for member in members:
                value = value[member]
            return value
        if isinstance(told, dict):
            whole = self.run.any(kind)
            known = {x: (own, many) for own, x, many in self.code.types.get(kind, ())}
            for name, member in told.items():
                whole[name] = self.entries(member, *known[name])
            return whole
        low, high = told
        if not LIMITS[kind][0] <= low <= high <= LIMITS[kind][1]:
            raise Fault(f"{low} to {high} are no numbers of {kind}")
        return Node(low, high, kind)

    def entries(self, told: Any, kind: str, many: tuple[int, ...]) -> Any:
        """As `argument`, of an array: a list of its entries, or what all can be."""
        if not many:
            return self.argument(told, kind)
        each = told if isinstance(told[0], list) else [told] * many[0]
        if len(each) != many[0]:
            raise Fault(f"{plain(told)} are not {many[0]} entries")
        return [self.entries(x, kind, many[1:]) for x in each]

    def inside(self, value: Any, told: Any, place: str) -> None:
        """A record must hold what is told of it."""
        if isinstance(value, dict):
            for name, member in value.items():
                self.inside(member, told[name], f"{place}.{name}")
        elif isinstance(value, list):
            for k, (entry, other) in enumerate(zip(value, told)):
                self.inside(entry, other, f"{place}[{k}]")
        elif value.lost or value.low < told.low or value.high > told.high:
            raise Fault(
                f"{place} may be {value.low} to {value.high}, not {told.low} to {told.high}"
            )

    def call(self, told: dict[str, Any]) -> str:
        """One call; says what is confirmed.

        A record that is changed is of a named state before and after; it may be anything before.
        """
        name, arguments = told["function"], told["arguments"]
        parameters = self.code.functions[name][1]
        given = [self.argument(arguments[own], kind) for kind, own, _ in parameters]
        self.run.call(name, given)
        for value, (kind, own, pointer) in zip(given, parameters):
            state = told.get("after", arguments)[own] if pointer and own != "gains" else None
            if state is None or own == "measured" or arguments[own] in self.code.constants:
                continue
            if arguments[own] not in ("any", state) or state not in self.stated["states"]:
                raise Fault(f"{name}: {own} is not given by a state")
            self.inside(value, self.argument(state, kind), f"{name}: {own}")
        words = ", ".join(f"{own} {plain(x)}" for own, x in arguments.items())
        return f"{name}: nothing leaves its type for {words}"


def plain(told: Any) -> str:
    """Ranges in words."""
    if isinstance(told, dict):
        return "(" + (", ".join(f"{n} {plain(x)}" for n, x in told.items()) or "its types") + ")"
    if isinstance(told, list) and isinstance(told[0], list):
        return "[" + ", ".join(map(plain, told)) + "]"
    return told if isinstance(told, str) else f"{told[0]} to {told[1]}"


FULLEST = re.compile(r"the fullest, '[^']*', reaches ([\d.]+)% of (int\d+_t)")


# Part 3. What is confirmed.


def claims(stated: dict[str, Any], beside: kit.Beside) -> Iterator[str]:
    """What is not covered, and each claim that is confirmed, in words."""
    code = c_text.Code()
    for name in stated["headers"]:
        code.read(beside.folder, name)
    made = Claims(stated, code)
    said = [made.call(told) for told in stated["calls"]]
    said += [f"{name} stays within {plain(told)}" for name, told in stated["states"].items()]
    made_of = {True: "{} makes an angle, which wraps", False: "'{}' is an angle and wraps"}
    said += [made_of[name in code.functions].format(name) for name in stated["wraps"]]
    for name, comments in code.said.items():
        found = FULLEST.search(comments)
        if found is None:
            raise Fault(f"{name}: it does not say how full its words are")
        most, place = made.run.fullest.get((name, found[2]), (0, ""))
        used = Fraction(most, LIMITS[found[2]][1] + 1)
        if used * 100 > Fraction(found[1]) + Fraction(1, 20000):
            raise Fault(f"{place} reaches {float(used):.4%} of {found[2]}, {name} says {found[1]}%")
        said.append(f"{name}: no product and no sum exceeds {found[1]}% of {found[2]}")
    left = sorted(set(code.functions) - made.run.called)
    yield "; ".join([*stated["not_covered"], *left]) or "nothing"
    yield from said


main = kit.program("check_ranges", "_ranges.json", claims)

if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
