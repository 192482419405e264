"""A harness around an emitted header, with what goes in and what must come out."""

from __future__ import annotations

from dataclasses import field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.errors import VerificationError
from dqforge.machines.records import dataclass


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
