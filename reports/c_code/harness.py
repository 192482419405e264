"""A harness around an emitted header, with what goes in and what must come out."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from textwrap import wrap as folded
from typing import TYPE_CHECKING, Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from dqforge import __version__
from dqforge.machines.design.design import Design
from dqforge.machines.errors import VerificationError
from dqforge.machines.records import dataclass
from dqforge.optimizer.current_reference.forms import FIXED_WIDTHS
from dqforge.optimizer.curves.single_precision import SINGLE, SingleArray
from dqforge.optimizer.steps import angle_functions
from dqforge.optimizer.steps.step_arithmetic import Pair, Rotation
from dqforge.reports.c_code.numbers import (
    comment_text,
    hexadecimal_word,
    int32_literal,
    int64_literal,
)
from dqforge.reports.plain_data import PlainData

if TYPE_CHECKING:
    from dqforge.optimizer.solution import Solution


@dataclass(frozen=True, slots=True)
class Harness:
    """What is done with each row of numbers, by a harness and by the test vectors of its header.

    In lines of C, ``@`` stands for the prefix and ``@@`` for it in capitals.

    Args:
        header: What stands between ``<prefix>_`` and ``.h``; empty for the main header.
        told: What goes in; and what comes out.
        counts: How many numbers go in and come out.
        body: Statements that make ``out`` of ``in``.
        number, result: Their types.
        vectors: Whether the body stands in ``<prefix>_<header>_vectors.h``.
        states: Declarations of what is kept from row to row.
        starts: Statements before the first row.
    """

    header: str
    told: str
    counts: tuple[int, int]
    body: tuple[str, ...]
    number: str = "float"
    result: str = ""
    vectors: bool = True
    states: tuple[str, ...] = ()
    starts: tuple[str, ...] = ()

    def _stem(self, prefix: str) -> str:
        return f"{prefix}_{self.header}" if self.header else prefix

    def source(self, prefix: str) -> str:
        """A program that runs rows from standard input and writes their results."""
        stem, own = self._stem(prefix), f"{prefix}_{self.header or 'vectors'}"
        kind = "floats" if self.number == "float" else self.number
        told = f"Runs {stem}.h on rows of {kind} from standard input: {self.told}."
        body, result = self.body, f"({own}_mismatches() == 0U) ? 0 : 1"
        return _joined(
            _comment(told),
            "#include <stdio.h>",
            "#include <string.h>",
            "",
            f'#include "{stem}{"_vectors" if self.vectors else ""}.h"',
            "",
            "int main(void)",
            "{",
            *_filled(1, self.states, prefix),
            f"    {self.number} in[{self.counts[0]}];",
            f"    {self.result or self.number} out[{self.counts[1]}];",
            "",
            *_filled(1, self.starts, prefix),
            "    while (fread(in, sizeof in, 1U, stdin) == 1U) {",
            *([f"        {own}_row(in, out);"] if self.vectors else _filled(2, body, prefix)),
            "        if (fwrite(out, sizeof out, 1U, stdout) != 1U) {",
            "            return 2;",
            "        }",
            "    }",
            f"    return {result if self.vectors else 0};",
            "}",
        )

    def files(self, design: Design, header: str, rows: NDArray[Any]) -> dict[str, bytes]:
        """Names and bytes of a header and of its test vectors.

        Args:
            design: What the prefix and the checksum are from.
            header: Text of the header.
            rows: Inputs and results of the model, shape (N, columns).
        """
        prefix = design.export.prefix
        stem, own = self._stem(prefix), f"{prefix}_{self.header or 'vectors'}"
        single, guard, number = self.number == "float", f"{stem.upper()}_VECTORS_H", self.number
        table = f"{own}_vectors" if self.header else own
        literal = hexadecimal_word if single else int64_literal if "64" in number else int32_literal
        lines = [f"    {{ {', '.join(literal(value) for value in row)} }}," for row in rows]
        lines[-1] = lines[-1].removesuffix(",")
        copied = [
            f"        float in[{self.counts[0]}];",
            f"        memcpy(in, {table}[k], sizeof in);",
            f"        {own}_row(in, out);",
        ]
        text = _joined(
            f"/* {stem}_vectors.h - test vectors for {stem}.h"
            f"{', as the 32 bits of each float' if single else ''}",
            " *",
            f" * Made by dqforge {__version__}; do not edit.",
            f" * Input file: SHA-256 {design.digest}",
            *([" *", f" * {_ROUNDING}"] if single else []),
            " */",
            f"#ifndef {guard}",
            f"#define {guard}",
            "",
            "#include <stdint.h>",
            "#include <string.h>",
            "",
            f'#include "{stem}.h"',
            "",
            "#ifdef __cplusplus",
            'extern "C" {',
            "#endif",
            "",
            f"#define {own.upper()}_COUNT ({len(rows)}U)",
            "",
            _comment(f"{self.told[0].upper()}{self.told[1:]}."),
            f"static const {'uint32_t' if single else number} "
            f"{table}[{len(rows)}][{sum(self.counts)}] = {{",
            *lines,
            "};",
            "",
            "/* The results of a row of inputs. */",
            f"static inline void {own}_row(const {number} *in, {number} *out)",
            "{",
            *_filled(1, self.body, prefix),
            "}",
            "",
            "/* Number of test vectors with a result that differs. */",
            f"static inline uint32_t {own}_mismatches(void)",
            "{",
            "    uint32_t mismatches = 0U;",
            "    uint32_t k;",
            "",
            f"    for (k = 0U; k < {own.upper()}_COUNT; ++k) {{",
            *copied[:single],
            f"        {number} out[{self.counts[1]}];",
            "",
            *(copied[1:] if single else [f"        {own}_row({table}[k], out);"]),
            f"        if (memcmp(out, &{table}[k][{self.counts[0]}], sizeof out) != 0) {{",
            "            ++mismatches;",
            "        }",
            "    }",
            "    return mismatches;",
            "}",
            "",
            "#ifdef __cplusplus",
            "}",
            "#endif",
            "",
            f"#endif /* {guard} */",
        )
        return {f"{stem}.h": header.encode("ascii"), f"{stem}_vectors.h": text.encode("ascii")}


_COMMENT_WIDTH = 110
_ROUNDING = (
    "They hold for IEEE 754 single precision without fused multiply-add (compile with "
    "-ffp-contract=off)."
)


def _joined(*lines: str) -> str:
    return "".join(f"{line}\n" for line in lines)


def _comment(text: str) -> str:
    first, *rest = folded(comment_text(text), _COMMENT_WIDTH)
    return "\n".join([f"/* {first}", *(f" * {line}" for line in rest)]) + " */"


def _filled(depth: int, lines: Sequence[str], prefix: str) -> list[str]:
    """Lines of C with the prefix, further in."""
    named = (line.replace("@@", prefix.upper()).replace("@", prefix) for line in lines)
    return [f"{'    ' * depth}{line}" if line else "" for line in named]


def control_harness(
    drives: int,
    told: str,
    reference: int,
    inputs: int,
    further: tuple[str, ...],
    duties: str,
    results: tuple[str, ...],
) -> Harness:
    """Rows of control functions: each of so many drives gets every so-manieth one.

    Args:
        drives: How many.
        told: What a row holds behind the six measured numbers.
        reference: Column of the reference, or of its d axis.
        inputs: How many columns there are.
        further: Statements before the control.
        duties: Type of the duty cycles, without prefix.
        results: What comes out before the reference of the currents and the torque.
    """
    gains = "&@@_CONTROL_GAINS, state, &measured"
    measured = ("i.a", "i.b", "i.c", "theta_e", "omega_m", "v_dc")
    outputs = (*results, "state->reference.d", "state->reference.q", "state->torque")
    return Harness(
        "control",
        f"drive n of {drives} gets every {drives}th; mode (0 current, 1 torque, 2 speed control), "
        f"i_a, i_b, i_c, theta_e, omega_m, v_dc, {told}; duty cycles, voltage, reference, torque",
        (inputs, len(outputs)),
        (
            "@_control_t *state = &states[n];",
            "@_measured_t measured;",
            f"@_{duties}_t duty;",
            "",
            *(f"measured.{name} = in[{column}];" for column, name in enumerate(measured, 1)),
            *further,
            "if (in[0] < 0.5F) {",
            "    @_dq_t reference;",
            "",
            f"    reference.d = in[{reference}];",
            f"    reference.q = in[{reference + 1}];",
            f"    duty = @_current_control({gains}, reference);",
            "} else if (in[0] < 1.5F) {",
            f"    duty = @_torque_control({gains}, in[{reference}]);",
            "} else {",
            f"    duty = @_speed_control({gains}, in[{reference}]);",
            "}",
            *(f"out[{k}] = {result};" for k, result in enumerate(outputs)),
            f"n = (n + 1U) % {drives}U;",
        ),
        vectors=False,
        states=(f"static @_control_t states[{drives}];", "unsigned n;"),
        starts=(
            f"for (n = 0U; n < {drives}U; ++n) {{",
            "    @_control_start(&states[n]);",
            "}",
            "n = 0U;",
        ),
    )


def observer_harness(
    header: str, code: str, told: str, further: int, results: tuple[str, ...]
) -> Harness:
    """Rows of an observer: start flag, its angle and speed, voltage, current and more columns."""
    more = "".join(f", in[{7 + k}]" for k in range(further))
    return Harness(
        header,
        f"start flag, angle, speed, v, i{told}",
        (7 + further, len(results)),
        (
            "const @_alphabeta_t v = { in[3], in[4] };",
            "const @_alphabeta_t i = { in[5], in[6] };",
            "",
            "if (in[0] > 0.0F) {",
            f"    @_{code}_start(&observer, in[1], in[2]);",
            "}",
            f"@_{code}_step(&@@_{code.upper()}_GAINS, &observer, v, i{more});",
            *(f"out[{k}] = observer.{result};" for k, result in enumerate(results)),
        ),
        vectors=False,
        states=(f"@_{code}_t observer;",),
        starts=(f"@_{code}_start(&observer, 0.0F, 0.0F);",),
    )


@dataclass(frozen=True, slots=True)
class Programme:
    """A harness with its inputs, shape (N,) or (N, M), and what it must return bit for bit,
    shape (N, width); ``name`` says what it runs, for messages.
    """

    harness: Harness
    inputs: NDArray[Any]
    model: NDArray[Any]
    name: str = "current reference"

    def results(self, content: bytes) -> NDArray[Any] | None:
        """What the harness wrote, of the shape and type of the model.

        None where that is not its size.
        """
        if len(content) != self.model.nbytes:
            return None
        return np.frombuffer(content, dtype=self.model.dtype).reshape(self.model.shape)

    def require_model(
        self, found: NDArray[Any], place: str, author: str, kind: str = "", *, any_nan: bool
    ) -> None:
        """Compare results with the model bit for bit.

        Args:
            found: Results of the compiled harness, of the shape and type of the model.
            place, author: Where it ran and what gave the results, for the message.
            kind: What the message says of the model.
            any_nan: Whether one not-a-number is as good as another.

        Raises:
            VerificationError: Rows differ; the message has the first.
        """
        bits = np.dtype(f"u{self.model.dtype.itemsize}")
        model = np.ascontiguousarray(self.model)
        unlike = found.view(bits) != model.view(bits)
        if any_nan and model.dtype.kind == "f":
            unlike &= ~(np.isnan(found) & np.isnan(model))
        rows = np.flatnonzero(np.any(unlike, axis=1))
        if rows.size:
            first = int(rows[0])
            raise VerificationError(
                f"{place} {rows.size} of {len(model)} results of the {self.name} differ from the "
                f"{kind}model; first at {self.inputs[first]!s}: {author} gives "
                f"{found[first].tolist()}, model {model[first].tolist()}"
            )


# Single precision, in which transforms, angle functions and steps equal their C functions, bit for
# bit without contraction of products and sums (-ffp-contract=off).

# The float next to pi, which lies above it; `wrap` returns less than this.
PI = np.float32(angle_functions.PI)


def wrap(theta: SingleArray) -> SingleArray:
    """Angle in rad brought into -pi to pi (pi excluded); 0 for not-a-number and beyond 65536
    rad.
    """
    return angle_functions.wrap(SINGLE, theta)


def rotation(theta: SingleArray) -> Rotation:
    """Cosine and sine of angles in rad; largest error 1.2e-7 from -pi to pi, those of 0 for
    not-a-number and beyond 65536 rad.
    """
    return angle_functions.rotation(SINGLE, theta)


def small_rotation(theta: SingleArray) -> Rotation:
    """Cosine and sine of angles in rad, by shorter polynomials within 0.4 rad; largest error as of
    `rotation`.
    """
    return angle_functions.small_rotation(SINGLE, theta)


def turned(x: Pair, y: Pair) -> Rotation:
    """The rotation by the sum of two angles."""
    return angle_functions.turned(SINGLE, x, y)


# What the main header holds beside its evaluator: constants in groups, without names in C.


@dataclass(frozen=True, slots=True)
class Constant:
    """One number of the header.

    Args:
        quantity: What it is, as ``<group>.<symbol>`` (``i_d.kp``); a dialect finds its name by it.
        value: In ``unit``; a whole number for what is counted and for codes.
        unit: SI unit, ``per unit``, or empty for a pure number.
        meaning, note: What it is, and what is said behind the unit.
        base: What one is of a value per unit, by the quantities of its bases.
        bits: Fractional bits of a code, None of other numbers.
    """

    quantity: str
    value: float
    unit: str
    meaning: str = ""
    note: str = ""
    base: str = ""
    bits: int | None = None


# What every emitted file says of itself: its prefix, the design, the tool's version
# and the input's checksum.


def title(design: Design) -> PlainData:
    """First lines of a header: ``prefix``, ``macro`` (the prefix in capitals), ``name``,
    ``version``, ``digest``.
    """
    prefix = design.export.prefix
    return {
        "prefix": prefix,
        "macro": prefix.upper(),
        "name": design.name,
        "version": __version__,
        "digest": design.digest,
    }


@dataclass(frozen=True, slots=True)
class ConstantGroup:
    """Constants that belong together, with a title and lines of comment."""

    title: str
    constants: tuple[Constant, ...] = ()
    comment: tuple[str, ...] = ()


# Floats of a result read back from plain data: finite numbers alone,
# and never a truth value for a number.


def single_from(value: Any) -> np.float32:
    """A float32 from a number.

    Raises:
        TypeError, ValueError: It is no number, or not finite in single precision.
    """
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise TypeError
    with np.errstate(over="ignore"):
        single = np.float32(value)
    if not math.isfinite(single):
        raise ValueError
    return single


def singles_from(values: Any, most: int) -> SingleArray:
    """Float32 values from a list of 1 to ``most`` numbers; raises as `single_from`."""
    array: SingleArray = np.array([single_from(value) for value in values], dtype=np.float32)
    if not 1 <= array.size <= most:
        raise ValueError
    return array


# A kind of header beside the main one: its files, its data, its way back and its harness.

SWEEP_POINTS = 20_000


SWEEP_SEED = 7

R = TypeVar("R")
M = TypeVar("M")


@dataclass(frozen=True, slots=True)
class HeaderKind(Generic[R, M]):
    """One kind of header.

    Args:
        name: Part of the file names ``<prefix>_<name>.h`` and of the key ``<name>_header`` in
            ``result.json``.
        files: Names and bytes of its files for a result.
        plain: What ``result.json`` says of it, from which alone its model is built again; None
            where the result has no header of this kind.
        read: Model from its plain data and the whole result; raises InputError where they are not
            what dqforge writes.
        programme: Harness, inputs and results of a model.
        vectors: Whether ``<prefix>_<name>_vectors.h`` is written too, with a function
            ``<prefix>_<name>_mismatches``.
    """

    name: str
    files: Callable[[Solution, R], dict[str, bytes]]
    plain: Callable[[Solution, R], PlainData | None]
    read: Callable[[Mapping[str, Any], Mapping[str, Any]], M]
    programme: Callable[[M], Programme]
    vectors: bool = True

    @property
    def key(self) -> str:
        """Key of its plain data in ``result.json``."""
        return f"{self.name}_header"

    def file_names(self, prefix: str) -> list[str]:
        """Names of its files."""
        return [
            f"{prefix}_{self.name}.h",
            *([f"{prefix}_{self.name}_vectors.h"] if self.vectors else []),
        ]


F = TypeVar("F")


def integer_kinds(
    name: str,
    width_of: Callable[[F], int],
    files: Callable[[Solution, F], dict[str, bytes]],
    plain: Callable[[F], PlainData],
    read: Callable[[Mapping[str, Any], int, Mapping[str, Any]], M],
    programme: Callable[[M], Programme],
) -> tuple[HeaderKind[tuple[F, ...], M], ...]:
    """Headers ``<prefix>_<name>_q15.h`` and ``<prefix>_<name>_q31.h`` of a result that is a fit
    per fixed-point format.

    Args:
        name: What comes before the format.
        width_of: Bits of the codes of a fit.
        files, plain, programme: As of `HeaderKind`, of one fit.
        read: Model from its plain data, the bits of its codes and the whole result.
    """

    def kind(width: int) -> HeaderKind[tuple[F, ...], M]:
        def found(fits: tuple[F, ...]) -> F | None:
            return next((fit for fit in fits if width_of(fit) == width), None)

        def files_of(solution: Solution, fits: tuple[F, ...]) -> dict[str, bytes]:
            fit = found(fits)
            return {} if fit is None else files(solution, fit)

        def plain_of(_: Solution, fits: tuple[F, ...]) -> PlainData | None:
            fit = found(fits)
            return None if fit is None else plain(fit)

        return HeaderKind(
            name=f"{name}_q{width - 1}",
            files=files_of,
            plain=plain_of,
            read=lambda own, result: read(own, width, result),
            programme=programme,
        )

    return tuple(kind(width) for width in FIXED_WIDTHS.values())
