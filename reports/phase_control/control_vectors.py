"""The run that proves the control of phase machines: sequences that visit every mode."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from dqforge.machines.topologies.topology import TOPOLOGIES
from dqforge.reports.c_code.harness import Programme
from dqforge.reports.phase_control.float32_model import PhaseControlModel, PhaseControlState

if TYPE_CHECKING:
    from dqforge.optimizer.curves.single_precision import SingleArray

_DRIVES, _STEPS = 48, 160

_SEED = 20_261_122

_COLUMNS = 11


def phase_control_inputs(model: PhaseControlModel) -> SingleArray:
    """Sequences for the harness, shape (steps * drives, 11).

    Drives with currents near their references and far off, at rest, at speeds from few to many
    samples per period and beyond all harmonics, with links that bind and that do not, phases that
    open and close, and samples that are no numbers.
    """
    gains, made = model.gains, model.structure
    generator = np.random.default_rng(_SEED)
    shape = (_STEPS, _DRIVES)
    torque_max, t_s = float(gains["torque_max"]), float(gains["t_s"])
    per_ampere = 1.5 * float(gains["pole_pairs"]) * float(gains["psi_pm"])
    ampere = torque_max / per_ampere
    spread = generator.choice([0.02, 1.0, 30.0], size=_DRIVES)
    # samples per electrical period from 3 to 3000, both directions; two drives at rest
    samples = 3.0 * 1000.0 ** generator.uniform(0.0, 1.0, _DRIVES)
    omega_e = 2.0 * np.pi / (samples * t_s) * generator.choice([-1.0, 1.0], size=_DRIVES)
    omega_e[:2] = 0.0
    emf = np.abs(omega_e) * float(gains["psi_pm"])
    v_dc = (emf + 10.0) * generator.choice([0.5, 1.5, 3.0, 20.0], size=_DRIVES)
    rows = np.zeros((*shape, _COLUMNS))
    rows[..., 0] = np.arange(_DRIVES) % 3
    rows[..., 1:4] = generator.normal(size=(*shape, 3)) * (spread * ampere)[:, None]
    rows[..., 4] = np.arange(_STEPS)[:, None] * omega_e * t_s + generator.uniform(-9, 9, _DRIVES)
    rows[..., 5] = (
        omega_e / float(gains["pole_pairs"]) * (1.0 + 0.01 * generator.normal(size=shape))
    )
    rows[..., 6] = v_dc * generator.uniform(0.9, 1.1, shape)
    rows[..., 7] = rows[..., 6] * generator.uniform(0.4, 0.6, shape)
    rows[..., 8:10] = (
        generator.normal(size=(*shape, 2)) * (np.minimum(spread, 1.0) * ampere)[:, None]
    )
    torque = generator.uniform(-1.2, 1.2, shape) * torque_max
    rows[..., 8] = np.where(rows[..., 0] == 1, torque, rows[..., 8])
    speeds = rows[..., 5] * generator.uniform(0.0, 2.0, shape)
    rows[..., 8] = np.where(rows[..., 0] == 2, speeds, rows[..., 8])
    rows[..., 10] = -1.0
    if made.neutral:
        rows[60, :, 10] = np.arange(_DRIVES) % 5  # one drive in five has all phases, one bad number
        rows[130, :, 10] = 0.0
    _spoil(rows)
    return np.ascontiguousarray(rows.reshape(-1, _COLUMNS), dtype=np.float32)


def _spoil(rows: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> None:
    """Samples that are exactly equal, zero, or no numbers, one column at a time."""
    rows[:3, :, 1:4] = 0.0
    rows[2, :, 8:10] = 0.0
    rows[5, :, 6:8] = 0.0  # no DC-link voltage
    rows[7, :, 4] = 70_000.0  # an angle beyond all sense
    for bad, start in ((np.nan, 10), (np.inf, 22), (-np.inf, 34)):
        for place, column in enumerate(range(1, 10)):
            rows[start + place, :, column] = bad


def phase_control_results(model: PhaseControlModel, inputs: SingleArray) -> SingleArray:
    """What the harness must return for `phase_control_inputs`, shape (N, legs + 6)."""
    with np.errstate(invalid="ignore", over="ignore", divide="ignore", under="ignore"):
        return _results(model, inputs)


def _results(model: PhaseControlModel, inputs: SingleArray) -> SingleArray:
    made = model.structure
    rows = inputs.reshape(-1, _DRIVES, _COLUMNS)
    width = len(TOPOLOGIES[made.topology].legs) + 6
    results = np.empty((rows.shape[0], _DRIVES, width), dtype=np.float32)
    # Three modes side by side: one step of the control for all drives.
    by_current, by_speed = np.arange(_DRIVES) % 3 == 0, slice(2, _DRIVES, 3)
    state = PhaseControlState.start(_DRIVES, made)
    loop = PhaseControlState.start(_DRIVES // 3, made)
    for step, row in enumerate(rows):
        first, second = (np.ascontiguousarray(row[:, column]) for column in (8, 9))
        measured = np.ascontiguousarray(row[:, 1:8] if made.midpoint else row[:, 1:7])
        if made.neutral:
            command = row[:, 10]
            state.open_phase(np.maximum(command, 0.0).astype(np.uint32), command >= 0.0)
        torque = first.copy()
        torque[by_speed] = model.speed_loop(loop, measured[by_speed], first[by_speed])
        state.torque = np.where(by_current, np.float32(0.0), torque)
        given, limit = model.of_currents(measured, (first, second))
        made_of, limited = model.of_torque(state, measured, torque)
        reference = tuple(np.where(by_current, *both) for both in zip(given, made_of, strict=True))
        duty = model.control_step(state, measured, reference, np.where(by_current, limit, limited))
        results[step] = np.stack(
            [*duty, *state.v, state.v_0, *state.reference, state.torque], axis=1
        )
    return results.reshape(-1, width)


def phase_control_programme(model: PhaseControlModel) -> Programme:
    """The harness of the control functions."""
    inputs = phase_control_inputs(model)
    made = model.structure
    return Programme(
        "phase_control/harness.c.j2",
        inputs,
        phase_control_results(model, inputs),
        {
            "drives": _DRIVES,
            "legs": list(made.legs),
            "neutral": made.neutral,
            "midpoint": made.midpoint,
        },
        name="control functions",
    )
