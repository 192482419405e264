"""Slopes of the references and voltage feedback on numpy arrays of float32, as
``control/references.j2`` has them: same operations, same bits.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from dqforge.machines.records import dataclass
from dqforge.optimizer.curves.single_precision import SingleArray
from dqforge.reports.c_code.read_back import single_from

Singles = tuple[SingleArray, ...]

_ZERO, _ONE = np.float32(0.0), np.float32(1.0)


@dataclass(slots=True)
class ReferenceState:
    """State of N drives, arrays of shape (N,), as ``<prefix>_references_t``."""

    torque: SingleArray
    current: Singles
    square: SingleArray
    added: SingleArray

    @classmethod
    def start(cls, count: int) -> ReferenceState:
        """Everything at rest."""
        rest = [np.zeros(count, dtype=np.float32) for _ in range(5)]
        return cls(rest[0], (rest[1], rest[2]), rest[3], rest[4])


@dataclass(frozen=True, slots=True)
class ReferenceModel:
    """Members of ``<prefix>_reference_gains_t``, float32, None where they are not asked for.

    ``feedback`` is (A per V^2, largest d current in A, current limit in A).
    """

    torque_step: np.float32 | None
    current_step: np.float32 | None
    feedback: tuple[np.float32, np.float32, np.float32] | None

    def ramped_torque(self, state: ReferenceState, torque: SingleArray) -> SingleArray:
        """The torque reference in N m, shape (N,)."""
        if self.torque_step is None:
            return torque
        asked = np.where(np.isnan(torque), _ZERO, torque)
        high, low = state.torque + self.torque_step, state.torque - self.torque_step
        state.torque = np.where(asked > high, high, np.where(asked < low, low, asked))
        return state.torque

    def weakened(self, state: ReferenceState, v_max: SingleArray, reference: Singles) -> Singles:
        """Current references (d, q) in A with what the feedback adds, shapes (N,)."""
        if self.feedback is None:
            return reference
        gain, most, limit = self.feedback
        lack = (v_max * v_max) - state.square
        added = state.added + (gain * lack)
        added = np.where(added < _ZERO, added, _ZERO)
        added = np.where(added > -most, added, -most)
        state.added = added
        d = reference[0] + added
        d = np.where(d > -limit, d, -limit)
        room = (limit * limit) - (d * d)
        room = np.where(room > _ZERO, room, _ZERO)
        q = reference[1]
        edge = np.sqrt(room)
        beyond = (added < _ZERO) & ((q * q) > room)
        return d, np.where(beyond, np.where(q < _ZERO, -edge, edge), q)

    def ramped_current(self, state: ReferenceState, reference: Singles) -> Singles:
        """Current references (d, q) in A no faster than their slope, shapes (N,)."""
        if self.current_step is None:
            return reference
        step, (here_d, here_q) = self.current_step, state.current
        d, q = reference[0] - here_d, reference[1] - here_q
        square = (d * d) + (q * q)
        beyond = square > (step * step)
        share = step / np.sqrt(np.where(beyond, square, _ONE))
        state.current = (
            np.where(beyond, here_d + (share * d), reference[0]),
            np.where(beyond, here_q + (share * q), reference[1]),
        )
        return state.current


def reference_model(plain: Mapping[str, Any] | None) -> ReferenceModel | None:
    """Read the members back from plain data; None where a control has none.

    Raises KeyError, TypeError or ValueError where they are no such data.
    """
    if plain is None:
        return None
    torque, current = plain["torque_step"], plain["current_step"]
    feedback = None
    if plain["feedback"] is not None:
        feedback = (
            single_from(plain["feedback"]),
            single_from(plain["feedback_max"]),
            single_from(plain["i_max"]),
        )
    return ReferenceModel(
        None if torque is None else single_from(torque),
        None if current is None else single_from(current),
        feedback,
    )
