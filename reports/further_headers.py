"""The headers that a design may ask for beside that of its current reference, each with its way back from the result.

A header is described in ``result.json`` under ``<name>_header``; what stands there alone rebuilds the model that its
compiled functions must equal.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from dqforge.machines.errors import InputError
from dqforge.optimizer.drop_reference import DropReference
from dqforge.optimizer.fixed_control import FixedControl
from dqforge.optimizer.phase_reference import PhaseReference
from dqforge.optimizer.schedule_fit import GainEvaluator
from dqforge.reports.control_fixed_header import fixed_control_from
from dqforge.reports.control_fixed_model import row_inputs, row_results
from dqforge.reports.control_header import control_from, control_programme
from dqforge.reports.gains_header import evaluator_from, schedule_inputs
from dqforge.reports.observer_header import EmittedObserver, observer_from
from dqforge.reports.observer_model import observer_inputs, observer_outputs
from dqforge.reports.programme import Programme
from dqforge.reports.rule_header import EmittedRule, emitted_from, rule_inputs, rule_results
from dqforge.reports.speed_observer_header import (
    ReducedOrderGains,
    speed_observer_from,
    speed_observer_inputs,
    speed_observer_outputs,
)
from dqforge.reports.surface_header import weakening_currents, weakening_from, weakening_inputs
from dqforge.reports.waveform_header import model_currents, phase_reference_from, waveform_inputs

SWEEP_POINTS = 20_000
SWEEP_SEED = 7


@dataclass(frozen=True, slots=True)
class FurtherHeader:
    """One kind of header.

    Parameters
    ----------
    name:
        Part of the file names ``<prefix>_<name>.h`` and of the key ``<name>_header`` in ``result.json``.
    read:
        Model from its plain data and the whole result; raises InputError where they are not what dqforge writes.
    programme:
        Harness, inputs and results of a model.
    vectors:
        Whether ``<prefix>_<name>_vectors.h`` is written too.
    """

    name: str
    read: Callable[[Mapping[str, Any], Mapping[str, Any]], Any]
    programme: Callable[[Any], Programme]
    vectors: bool = True

    @property
    def key(self) -> str:
        """Key of its plain data in ``result.json``."""
        return f"{self.name}_header"

    def files(self, prefix: str) -> list[str]:
        """Names of its files."""
        return [f"{prefix}_{self.name}.h", *([f"{prefix}_{self.name}_vectors.h"] if self.vectors else [])]


def _waveform_programme(reference: PhaseReference) -> Programme:
    inputs = waveform_inputs(reference, SWEEP_POINTS, SWEEP_SEED)
    return Programme("waveform_harness.c.j2", inputs, model_currents(reference, inputs), name="phase currents")


def _weakening_programme(reference: DropReference) -> Programme:
    half = SWEEP_POINTS // 2
    inputs = weakening_inputs(reference, half, SWEEP_SEED, patterns=half)
    results = weakening_currents(reference, inputs)
    return Programme("surface_harness.c.j2", inputs, results, name="current reference with field weakening")


def _control_fixed_programme(control: FixedControl) -> Programme:
    """In 16 bits as many rows as there are angles, so that each comes once."""
    inputs = row_inputs(control, 2**16 if control.width == 16 else SWEEP_POINTS, SWEEP_SEED)
    wide = np.dtype(f"i{control.width // 4}")
    context = {"width": control.width, "format": control.format}
    results = row_results(control, inputs).astype(wide)
    return Programme("control_fixed_harness.c.j2", inputs.astype(wide), results, context, name="fixed-point control")


def _rule_programme(rule: EmittedRule) -> Programme:
    half = SWEEP_POINTS // 2
    inputs = rule_inputs(rule, half, SWEEP_SEED, patterns=half)
    return Programme("choice_harness.c.j2", inputs, rule_results(rule, inputs), name="choice of modulator")


def _gains_programme(evaluator: GainEvaluator) -> Programme:
    half = SWEEP_POINTS // 2
    currents = schedule_inputs(evaluator, half, SWEEP_SEED, patterns=half)
    return Programme("gains_harness.c.j2", currents, evaluator.gains(currents), name="gains over the current")


def _observer_programme(observer: EmittedObserver) -> Programme:
    method, inputs = observer.method, observer_inputs(observer.gains, SWEEP_POINTS, SWEEP_SEED)
    outputs = observer_outputs(method, observer.gains, inputs)
    return Programme("observer_harness.c.j2", inputs, outputs, {"code": method.code}, name="position observer")


def _speed_observer_programme(gains: ReducedOrderGains) -> Programme:
    inputs = speed_observer_inputs(gains, SWEEP_POINTS, SWEEP_SEED)
    outputs = speed_observer_outputs(gains, inputs)
    return Programme("speed_observer_harness.c.j2", inputs, outputs, name="speed observer")


FURTHER_HEADERS = (
    FurtherHeader("waveform", lambda own, _: phase_reference_from(own), _waveform_programme),
    FurtherHeader("weakening", lambda own, _: weakening_from(own), _weakening_programme),
    FurtherHeader("modulation", lambda own, _: emitted_from(own), _rule_programme),
    FurtherHeader("gains", lambda own, _: evaluator_from(own), _gains_programme),
    FurtherHeader("observer", lambda own, _: observer_from(own), _observer_programme, vectors=False),
    FurtherHeader("speed_observer", lambda own, _: speed_observer_from(own), _speed_observer_programme, vectors=False),
    FurtherHeader("control", control_from, control_programme, vectors=False),
    FurtherHeader("control_q15", lambda own, _: fixed_control_from(own, 16), _control_fixed_programme),
    FurtherHeader("control_q31", lambda own, _: fixed_control_from(own, 32), _control_fixed_programme),
)
"""All kinds, in the order in which they are written and verified."""


def programmes(plain: Mapping[str, Any]) -> tuple[dict[str, FurtherHeader], list[Programme]]:
    """The further headers that a result describes by name, and their harnesses.

    Raises
    ------
    InputError
        What stands there is not what dqforge writes.
    """
    found = {}
    made = []
    for kind in FURTHER_HEADERS:
        described = plain.get(kind.key)
        if described is None:
            continue
        if not isinstance(described, dict):
            raise InputError(f"{kind.key} is not what dqforge writes; run the design again")
        found[kind.name] = kind
        made.append(kind.programme(kind.read(described, plain)))
    return found, made
