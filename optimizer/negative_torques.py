"""The reference of negative torques, where these have their own, solved and proven."""

from __future__ import annotations

from dqforge.machines.design.design import Design
from dqforge.machines.records import dataclass
from dqforge.optimizer.certificates.current_reference import Certificate, certify
from dqforge.optimizer.current_reference.fit import ReferenceFit, signed_designs
from dqforge.optimizer.current_reference.solve import solve_fit
from dqforge.optimizer.operating_points.solve import Curves, current_choice, solve_curves


@dataclass(frozen=True, slots=True)
class NegativeHalf:
    """The reference of negative torques where the halves of a machine are kept,
    as that of the mirrored machine.
    """

    design: Design
    curves: Curves
    fit: ReferenceFit
    certificate: Certificate | None


def solve_negative(design: Design) -> NegativeHalf | None:
    """Reference of negative torques of a design that keeps the halves of its machine apart.

    None for others.
    """
    mirrored = signed_designs(design)[1]
    if mirrored is None:
        return None
    found = solve_fit(mirrored).fit
    proof = certify(current_choice(mirrored), found.reference, found.errors)
    return NegativeHalf(mirrored, solve_curves(mirrored), found, proof)
