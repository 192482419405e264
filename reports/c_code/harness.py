"""A harness around an emitted header, with what goes in and what must come out."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from numpy.typing import NDArray


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
