"""Current references of positive and negative torques, where these differ."""

from __future__ import annotations

from dataclasses import replace

from dqforge.machines.design.design import Design
from dqforge.machines.errors import InputError
from dqforge.optimizer.current_reference.fit import ReferenceFit
from dqforge.optimizer.current_reference.forms import SignedReference
from dqforge.optimizer.current_reference.integer_form import FixedReference


def signed_reference(positive: ReferenceFit, negative: ReferenceFit) -> SignedReference:
    """The references of both signs of the torque as one.

    Args:
        positive, negative: Fits of positive torques, and of those of the mirrored machine.

    Raises:
        InputError: One of them is in fixed point.
    """
    if isinstance(positive.reference, FixedReference) or isinstance(
        negative.reference, FixedReference
    ):
        raise InputError(
            "machine.flux_map.symmetry: keep needs references in float32; write fit: format: "
            "float32"
        )
    return SignedReference(positive.reference, negative.reference)


def signed_designs(design: Design) -> tuple[Design, Design | None]:
    """The design as positive torques see it, and its mirror image as negative ones do.

    None where that is the same.
    """
    if design.halves is None:
        return design, None
    positive, negative = (replace(design, machine=half) for half in design.halves)
    return positive, negative
