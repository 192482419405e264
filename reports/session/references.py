"""Current references fitted for the firmware, and proven bounds of what they err by."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dqforge.machines.design.design import Design
from dqforge.machines.design.numerical import on_design
from dqforge.machines.errors import NoSolutionError
from dqforge.machines.records import dataclass
from dqforge.optimizer.certificates.current_reference import Certificate
from dqforge.optimizer.certificates.current_reference import certify as prove
from dqforge.optimizer.current_reference.alternatives import Alternative, alternatives
from dqforge.optimizer.current_reference.cheapest import FitChoice, Trial
from dqforge.optimizer.current_reference.forms import ReferenceErrors
from dqforge.optimizer.current_reference.signed import signed_designs, signed_reference
from dqforge.optimizer.current_reference.solve import solve_fit
from dqforge.optimizer.field_weakening.fit import WeakeningFit
from dqforge.optimizer.field_weakening.solve import solve_weakening
from dqforge.optimizer.negative_torques import NegativeHalf, solve_negative
from dqforge.optimizer.operating_points.solve import current_choice
from dqforge.reports.current_reference.plain import plain_fit, plain_negative
from dqforge.reports.field_weakening.plain import plain_weakening_fit
from dqforge.reports.plain_data import PlainData
from dqforge.reports.session.drives import numbers
from dqforge.reports.session.result import DrawnResult

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Fit(DrawnResult):
    """The current reference of a design, as the firmware evaluates it.

    ``choice`` holds the fit and the forms that were tried for a budget, ``alternatives`` other
    forms with their errors, ``negative`` the reference of negative torques where the halves of a
    machine are kept apart, ``weakening`` that over torque and speed where the design asks for one.
    ``certificate`` holds proven bounds once `certify` was asked.
    """

    design: Design
    choice: FitChoice
    alternatives: tuple[Alternative, ...]
    negative: NegativeHalf | None = None
    weakening: WeakeningFit | None = None
    certificate: Certificate | None = None

    @property
    def form(self) -> str:
        """Name of the form that is emitted."""
        return self.choice.fit.form

    @property
    def torque_max(self) -> float:
        """End of the domain in N m."""
        return self.choice.fit.torque_max

    @property
    def errors(self) -> ReferenceErrors:
        """Largest errors over the domain, found by sampling, in the arithmetic that is emitted."""
        return self.choice.fit.errors

    @property
    def trials(self) -> tuple[Trial, ...]:
        """Forms that were tried for a budget, in order of their cost."""
        return self.choice.trials

    def currents(self, torque: ArrayLike) -> tuple[NDArray[Any], NDArray[Any]]:
        """What the firmware computes in its own arithmetic: (i_d, i_q) in A for torques in N m,
        any sign and shape.
        """
        wanted = numbers(torque, "torque", "N m").astype(np.float32)
        positive = self.choice.fit
        emitted = (
            positive.reference
            if self.negative is None
            else signed_reference(positive, self.negative.fit)
        )
        found: tuple[NDArray[Any], NDArray[Any]] = emitted.currents(wanted.ravel())
        return found[0].reshape(wanted.shape), found[1].reshape(wanted.shape)

    def plain(self) -> PlainData:
        """By the keys of ``dqforge fit --json``."""
        choice = self.choice
        return {
            "fit": plain_fit(
                choice.fit, self.alternatives, choice.trials, self.certificate, choice.data
            ),
            **plain_negative(self.negative),
            "weakening": plain_weakening_fit(self.weakening),
        }

    def figure(self) -> Figure:
        """Currents, their errors, and what these cost in torque and loss."""
        from dqforge.reports.current_reference.figures import plot_fit

        return plot_fit(signed_designs(self.design)[0], self.choice.fit)


@on_design("fit")
def fit(design: Design) -> Fit:
    """Fit the current references of a design as its section ``fit`` asks.

    Args:
        design: With the form, or the budget that the cheapest one must keep.

    Raises:
        InputError, NoSolutionError: The form does not suit the machine, or no form keeps the
            budget.
    """
    positive = signed_designs(design)[0]
    chosen = solve_fit(positive)
    rows = alternatives(current_choice(positive), chosen.fit)
    return Fit(design, chosen, rows, solve_negative(design), solve_weakening(design))


def certify(asked: Design | Fit) -> Fit:
    """Bounds of the errors of a current reference, proven for every torque of its domain,
    rounding included.

    Args:
        asked: A design, or the fit of one.

    Returns:
        The fit with its ``certificate``.

    Raises:
        NoSolutionError: No bounds could be proven.
    """
    found = fit(asked) if isinstance(asked, Design) else asked
    proof = _proof(found.design, found)
    if proof is None:
        raise NoSolutionError(
            "fit: no bounds of the errors could be proven; those found by sampling are in "
            "fit().errors"
        )
    return replace(found, certificate=proof)


@on_design("fit")
def _proof(design: Design, found: Fit) -> Certificate | None:
    chosen = found.choice.fit
    return prove(current_choice(signed_designs(design)[0]), chosen.reference, chosen.errors)
