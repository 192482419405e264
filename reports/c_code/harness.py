"""A harness around an emitted header, with what goes in and what must come out."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import field
from typing import TYPE_CHECKING, Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from dqforge import __version__
from dqforge.machines.design.design import Design
from dqforge.machines.errors import VerificationError
from dqforge.machines.records import dataclass
from dqforge.optimizer.current_reference.forms import FIXED_WIDTHS
from dqforge.optimizer.curves.integer_polynomial import SingleArray
from dqforge.optimizer.steps import angle_functions
from dqforge.optimizer.steps.step_arithmetic import Arithmetic, Pair, Rotation
from dqforge.reports.plain_data import PlainData

if TYPE_CHECKING:
    from dqforge.optimizer.solution import Solution


@dataclass(frozen=True, slots=True)
class Programme:
    """A harness with its inputs, shape (N,) or (N, M), and what it must return bit for bit,
    shape (N, width).

    ``template`` makes the harness from the prefix and ``context``; ``name`` says what it runs,
    for messages.
    """

    template: str
    inputs: NDArray[Any]
    model: NDArray[Any]
    context: dict[str, Any] = field(default_factory=dict)
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


SINGLE = Arithmetic(np.float32, wrap, rotation)


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
