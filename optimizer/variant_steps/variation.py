"""Which keys of a study change numbers of a drive or factors of its flux map and nothing else, and
by what factor.

Found by trial, not by a list of what each key means: designs are made at the corners of what the
keys may be, and compared. A key whose corners differ in anything but the numbers that the batch
path knows, or not in proportion, varies design by design. Checks of a design are monotonic in each
of these numbers, so that what holds at all corners holds between them.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import fields, replace

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.design import Design
from dqforge.machines.design.settings import FitSettings
from dqforge.machines.dq_machines.saturated_machine import SaturatedMachine
from dqforge.machines.dq_machines.synchronous import LinearMachine, Machine
from dqforge.machines.errors import DqforgeError
from dqforge.machines.records import dataclass
from dqforge.optimizer.variant_steps.map_scales import scale_between
from dqforge.optimizer.variant_steps.step_cache import key_of

MACHINE_FIELDS = (
    "r_s",
    "l_d",
    "l_q",
    "psi_pm",
    "i_max",
    "inertia",
    "friction",
    "omega_m_max",
)

SATURATED_FIELDS = ("r_s", "i_max", "inertia", "friction", "omega_m_max")
INVERTER_FIELDS = ("v_dc", "f_sw", "i_max")
MOST_KEYS = 6  # Keys whose corners are all tried; with more the rows are made one by one.

# Parts of a design that tell of it and that no step looks at.
_RECORDS = ("values", "assumptions", "digest", "given", "places", "flux_evidence", "name", "about")
_PROPORTIONAL = 1e-12
Corner = Mapping[str, float]


@dataclass(frozen=True, slots=True)
class Effect:
    """What a key changes: fields as ``machine.r_s`` or ``inverter.v_dc``, by their factor over the
    key's SI value. Factors of a flux map, as ``machine.magnet``, are 1 in the machine of the base.
    """

    factors: tuple[tuple[str, float], ...]


@dataclass(frozen=True, slots=True, eq=False)
class Variation:
    """Keys that vary numbers of a drive, or factors of its flux map, alone.

    Args:
        base: The design with every key at its lower end.
        corners: Designs by key with that key alone at its upper end.
        effects: What each key changes.
        ends: Least and largest value of each key in SI units.
    """

    base: Design
    corners: Mapping[str, Design]
    effects: Mapping[str, Effect]
    ends: Mapping[str, tuple[float, float]]

    def columns(self, numbers: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
        """Values of the changed fields by their names, arrays of shape (N,).

        Args:
            numbers: Values of the keys in SI units, shape (N,).
        """
        return {
            name: factor * numbers[key]
            for key, effect in self.effects.items()
            for name, factor in effect.factors
        }

    def between(self, share: FloatArray) -> dict[str, FloatArray]:
        """Values of the changed fields on the way from the lower to the upper ends of all keys.

        Args:
            share: Shares of the way, shape (N,).
        """
        return self.columns(
            {key: low + share * (high - low) for key, (low, high) in self.ends.items()}
        )

    def keys_of(self, step_key: Callable[[Design], Hashable]) -> tuple[str, ...]:
        """Keys that a step depends on.

        Args:
            step_key: What the step of a design depends on.
        """
        plain = step_key(self.base)
        return tuple(key for key, made in self.corners.items() if step_key(made) != plain)


def variation(
    make: Callable[[Corner], Design], bounds: Mapping[str, tuple[float, float]]
) -> Variation | None:
    """How keys change a design between bounds.

    Args:
        make: The design with values of the keys in SI units.
        bounds: Least and largest value of each key in SI units.

    Returns:
        None where a corner is refused, or a key changes more than numbers of a drive or one factor
        of its flux map.
    """
    if len(bounds) > MOST_KEYS:
        return None
    try:
        corners = {pick: make(_corner(bounds, pick)) for pick in _picks(len(bounds))}
    except DqforgeError:
        return None
    base = corners[(0,) * len(bounds)]
    known = isinstance(base.machine, LinearMachine | SaturatedMachine)
    if not known or base.phase_machine is not None:
        return None
    ends = {key: corners[_single(len(bounds), place)] for place, key in enumerate(bounds)}
    effects = {}
    for key, made in ends.items():
        effect = _effect(base, made, bounds[key])
        if effect is None:
            return None
        effects[key] = effect
    if len({name for e in effects.values() for name, _ in e.factors}) != sum(
        len(e.factors) for e in effects.values()
    ):
        return None
    return Variation(base, ends, effects, dict(bounds))


def batch_keys(
    make: Callable[[Corner], Design], bounds: Mapping[str, tuple[float, float]]
) -> tuple[str, ...]:
    """Keys that change numbers of a drive, or factors of its flux map, alone, each by itself.

    Args:
        make: The design with values of some keys in SI units, the others as the study's first row.
        bounds: Least and largest value of each key in SI units.
    """
    return tuple(key for key, ends in bounds.items() if variation(make, {key: ends}) is not None)


def _picks(count: int) -> Sequence[tuple[int, ...]]:
    return list(itertools.product((0, 1), repeat=count))


def _single(count: int, place: int) -> tuple[int, ...]:
    return tuple(int(other == place) for other in range(count))


def _corner(bounds: Mapping[str, tuple[float, float]], pick: tuple[int, ...]) -> Corner:
    return {key: ends[end] for (key, ends), end in zip(bounds.items(), pick, strict=True)}


def _effect(base: Design, made: Design, ends: tuple[float, float]) -> Effect | None:
    """Fields that differ and their factors, None where anything else differs, too."""
    low, high = ends
    factors: list[tuple[str, float]] = []
    scaled = _scale(base, made, ends)
    if scaled is not None:
        factors.append((f"machine.{scaled}", 1.0 / low))
        made = _with_map_of(made, base)
    changed = _changed(base, made)
    if changed is None:
        return None
    for name in changed:
        first, last = _value(base, name), _value(made, name)
        if first is None or last is None or high == 0.0:
            return None
        if abs(last * low - first * high) > _PROPORTIONAL * abs(first * high):
            return None
        factors.append((name, last / high))
    return Effect(tuple(factors))


def _scale(base: Design, made: Design, ends: tuple[float, float]) -> str | None:
    """The factor of the flux map that differs, in proportion to the key; None where none does."""
    first, last = base.machine, made.machine
    if not isinstance(first, SaturatedMachine) or not isinstance(last, SaturatedMachine):
        return None
    low, high = ends
    if not low > 0.0 or _same(first.flux_map, last.flux_map):
        return None
    return scale_between(first, last, high / low)


def _with_map_of(design: Design, other: Design) -> Design:
    """The same with the flux map of another design."""
    machine, donor = design.machine, other.machine
    assert isinstance(machine, SaturatedMachine)
    assert isinstance(donor, SaturatedMachine)
    return replace(design, machine=replace(machine, flux_map=donor.flux_map))


def _changed(base: Design, made: Design) -> list[str] | None:
    """Numbers of machine and inverter that differ; None where more does."""
    found = []
    for part in fields(Design):
        first, last = getattr(base, part.name), getattr(made, part.name)
        if part.name in _RECORDS or _same(first, last):
            continue
        if part.name == "machine":
            names = [n for n in _machine_fields(first) if getattr(first, n) != getattr(last, n)]
            last = replace(last, **{name: getattr(first, name) for name in names})
        elif part.name == "inverter":
            names = [n for n in INVERTER_FIELDS if getattr(first, n) != getattr(last, n)]
            last = replace(last, **{name: getattr(first, name) for name in names})
        elif part.name == "control":  # bases of per-unit gains, which no output knows
            names, last = [], replace(last, bases=first.bases)
        elif part.name == "fit":
            names, first, last = [], used_settings(first), used_settings(last)
        else:
            return None
        if not _same(first, last):
            return None
        found += [f"{part.name}.{name}" for name in names]
    return found


def _machine_fields(machine: Machine) -> Sequence[str]:
    """Numbers of a machine that may vary."""
    return MACHINE_FIELDS if isinstance(machine, LinearMachine) else SATURATED_FIELDS


def used_settings(settings: FitSettings) -> FitSettings:
    """Settings of a fit without the full scale of fixed point where it is in floating point.

    Args:
        settings: The settings.
    """
    if settings.format == "float32" and settings.budget is None:
        return replace(settings, full_scale=None)
    return settings


def _same(first: object, last: object) -> bool:
    if first is last:
        return True
    return type(first) is type(last) and key_of(first) == key_of(last)


def _value(design: Design, name: str) -> float | None:
    part, _, own = name.partition(".")
    value = getattr(getattr(design, part), own)
    return None if value is None else float(value)
