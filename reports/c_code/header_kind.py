"""A kind of header beside the main one: its files, its data, its way back and its harness."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from dqforge.machines.records import dataclass
from dqforge.optimizer.current_reference.forms import FIXED_WIDTHS

if TYPE_CHECKING:
    from dqforge.optimizer.solution import Solution
    from dqforge.reports.c_code.harness import Programme
    from dqforge.reports.plain_data import PlainData

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
