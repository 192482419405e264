"""What a study file says, checked: the design it starts from, the keys that vary, what is drawn,
what is asked of each row.

Keys are the dotted paths of a design's messages. Rows are the grid points of ``axes`` in their
order, the last axis quickest; where something is drawn, each grid point has ``draw.count`` rows.
"""

from __future__ import annotations

from dataclasses import field
from typing import Literal

from dqforge.machines.files.positioned_yaml import YamlValue
from dqforge.machines.places import Places
from dqforge.machines.records import dataclass

DistributionKind = Literal["normal", "uniform", "between"]
Sampling = Literal["random", "sobol"]
Spacing = Literal["", "linear", "log"]
SearchMethod = Literal["nsga2", "nlopt"]


@dataclass(frozen=True, slots=True)
class Axis:
    """Keys that vary in step: one value of each per step, as a design file writes it.

    Args:
        keys: K dotted paths.
        steps: N tuples of K values.
        numbers: N tuples of the K values in SI units where every one is a plain quantity, else
            empty.
        spacing: How the steps of a range lie, between whose ends a search may take any value; empty
            for values that were listed.
    """

    keys: tuple[str, ...]
    steps: tuple[tuple[YamlValue, ...], ...]
    numbers: tuple[tuple[float, ...], ...] = ()
    spacing: Spacing = ""

    @property
    def continuous(self) -> bool:
        """Whether a search takes any number between its ends, and not one of its steps."""
        several = len(self.keys) > 1 or len(self.steps) < 2
        return bool(self.numbers and self.spacing) and not several


@dataclass(frozen=True, slots=True)
class Tolerance:
    """A key that is drawn, round the value of the design or between two bounds.

    Args:
        key: Dotted path of a quantity.
        kind: ``normal`` (standard deviation ``width``, cut at ``cut`` of them), ``uniform`` (half
            width ``width``) or ``between`` (``low`` to ``high``).
        width: Share of the design's value where ``relative``, else in the SI unit of the key.
        centre: The design's value in the SI unit of the key; what ``between`` needs none of.
    """

    key: str
    kind: DistributionKind
    width: float = 0.0
    relative: bool = True
    cut: float = 3.0
    low: float = 0.0
    high: float = 0.0
    centre: float = 0.0


@dataclass(frozen=True, slots=True)
class Draw:
    """How many rows are drawn, and from which seed; ``correlations`` are triples key, key, rho."""

    count: int
    seed: int
    sampling: Sampling = "random"
    correlations: tuple[tuple[str, str, float], ...] = ()


@dataclass(frozen=True, slots=True)
class Bound:
    """A limit on an output, in SI units.

    ``output`` is a name of `dqforge.optimizer.variant_steps.outputs`; ``point`` picks the operating
    point of a loss (torque in N m, speed in rad/s, modulator or empty), None all of them. ``unit``
    is the SI unit of both values, for a check against that of the output.
    """

    output: str
    below: float | None = None
    above: float | None = None
    point: tuple[float, float, str] | None = None
    unit: str = ""


@dataclass(frozen=True, slots=True)
class Goal:
    """An output that is made small, or large."""

    output: str
    minimise: bool = True


@dataclass(frozen=True, slots=True)
class Search:
    """A search instead of a grid: the axes' ends are its bounds."""

    method: SearchMethod
    population: int
    generations: int
    seed: int


@dataclass(frozen=True, slots=True)
class Study:
    """One study file.

    ``design_text`` are the bytes of the design it starts from, ``design_source`` its name for
    messages, ``named`` the bytes of each file that the design names. ``header`` is the folder of a
    fixed header, ``nominal`` one that is made now, empty none. ``digest`` is the SHA-256 of what
    the study asks, in hexadecimal, whatever its comments and the order of its keys.
    ``header_files`` are the files of the folder ``header`` by their names.
    """

    name: str
    about: str
    design_text: bytes
    design_source: str
    digest: str
    named: tuple[tuple[str, bytes], ...] = ()
    sets: tuple[tuple[str, YamlValue], ...] = ()
    axes: tuple[Axis, ...] = ()
    tolerances: tuple[Tolerance, ...] = ()
    draw: Draw | None = None
    header: str = ""
    outputs: tuple[str, ...] = ()
    limits: tuple[Bound, ...] = ()
    accept: tuple[Bound, ...] = ()
    goals: tuple[Goal, ...] = ()
    sensitivity: tuple[str, ...] = ()
    search: Search | None = None
    places: Places | None = field(default=None, compare=False, repr=False)
    header_files: tuple[tuple[str, bytes], ...] = field(default=(), repr=False)

    @property
    def saltelli(self) -> bool:
        """Whether the rows are those of a design for first-order and total sensitivities: drawn by
        a Sobol sequence alone, independently of each other.
        """
        draw = self.draw
        if draw is None or draw.sampling != "sobol" or draw.correlations or self.axes:
            return False
        return bool(self.sensitivity and self.tolerances)
