"""The whole interrupt of a drive without encoder, of what `export` emits with default settings:
observer, speed loop and current control of one sample as one called function.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from typing import Any

import numpy as np
from control_chain import Step
from numpy.typing import NDArray

from dqforge.machines.design import catalogue
from dqforge.machines.design.catalogue import load_text
from dqforge.machines.transforms import clarke_matrix
from dqforge.optimizer.operating_points.current_choice import CurrentChoice
from dqforge.optimizer.solution import Solution, solve
from dqforge.reports.run import emitted_files

DRIVE, PREFIX = "paper000-ipmsm-100kw", "ipm100"
SETTINGS = (
    "export.control=float32",
    "control.observer={method: flux, bandwidth: 300 Hz}",
)
SPEED_MAX = 200.0
_COUNT = 300

_STATE = (
    f"static {PREFIX}_control_t state; static {PREFIX}_flux_t observer;"
    f" static {PREFIX}_measured_t measured;"
)
_ROW = (
    "measured.i.a = r[0]; measured.i.b = r[1]; measured.i.c = r[2]; measured.theta_e = r[3];"
    " measured.omega_m = r[4]; measured.v_dc = r[5]; state.d.integral = r[6];"
    " state.q.integral = r[7]; state.speed.integral = r[8]; state.torque = r[8];"
    " state.v.alpha = r[9]; state.v.beta = r[10];"
)
_OBSERVED = (
    f" {PREFIX}_flux_start(&observer, r[3], {PREFIX.upper()}_CONTROL_GAINS.pole_pairs * r[4]);"
    " observer.started = 1; observer.psi.alpha = r[11]; observer.psi.beta = r[12];"
    " observer.i.alpha = r[13]; observer.i.beta = r[14];"
)
_REFERENCE = " dq.d = r[15]; dq.q = r[16];"


@cache
def solution() -> Solution:
    """The drive, its settings beside those of the library in `SETTINGS`."""
    return solve(load_text(catalogue.read_text(DRIVE), DRIVE, None, list(SETTINGS)))


def rows(*, shortened: bool) -> NDArray[np.float32]:
    """Samples at torques of either sign up to nine tenths of the largest, at speeds of either sense
    up to `SPEED_MAX` and 0.9 to 1 of the link.

    Currents lie within 2 % of their limit off the references, the voltage within 0.95 of what the
    modulator makes; ``shortened``: up to twice the limit off, the voltage above 1.05 of it.
    """
    design = solution().design
    machine, loops = design.machine, solution().gains
    generator = np.random.default_rng(20_261_128)
    count = 40 * _COUNT
    torque = 180.0 * generator.uniform(-1.0, 1.0, count)
    choice = CurrentChoice(machine, design.strategy, design.i_max)
    reference = np.stack(choice.currents(torque))
    spread = (2.0 if shortened else 0.02) * design.i_max
    i = reference + spread * generator.uniform(-1.0, 1.0, (2, count))
    theta = generator.uniform(-np.pi, np.pi, count)
    omega_m = SPEED_MAX * generator.uniform(-1.0, 1.0, count)
    omega = machine.pole_pairs * omega_m
    v_dc = design.inverter.v_dc * generator.uniform(0.9, 1.0, count)
    l_dq = np.array([[machine.l_d], [machine.l_q]])
    kp = np.array([[loops.i_d.kp], [loops.i_q.kp]])
    integral = machine.r_s * reference
    flux = l_dq * i + np.array([[machine.psi_pm], [0.0]])
    v = kp * (reference - i) + integral + omega * np.stack([-flux[1], flux[0]])
    size = np.hypot(*v) / (v_dc / np.sqrt(3.0))
    kept = np.flatnonzero(size > 1.05 if shortened else size < 0.95)[:_COUNT]
    if kept.size < _COUNT:
        raise ValueError("too few samples of the kind")

    def turned(x: NDArray[Any]) -> NDArray[Any]:
        return np.stack(
            [
                x[0] * np.cos(theta) - x[1] * np.sin(theta),
                x[0] * np.sin(theta) + x[1] * np.cos(theta),
            ]
        )

    still = turned(i)
    phases = np.linalg.inv(clarke_matrix()) @ np.vstack([still, np.zeros((1, count))])
    steady = machine.r_s * i + omega * np.stack([-flux[1], flux[0]])
    columns = [
        *phases, theta, omega_m, v_dc, *integral, torque, *turned(steady), *turned(flux), *still,
        *reference,
    ]  # fmt: skip
    return np.stack(columns, axis=1)[kept].astype(np.float32)


def _step(label: str, observer: str, call: str, *, dq: bool = False, shortened: bool) -> Step:
    files = {name: text for name, text in emitted_files(solution()).items() if name[-2:] == ".h"}
    headers = f'#include "{PREFIX}_control.h"\n#include "{PREFIX}_observer.h"\n'
    extra = f", {PREFIX}_dq_t dq" if dq else ", float reference"
    return Step(
        f"{label}, voltage {'shortened' if shortened else 'within its limit'}", "float32",
        files | {"interrupt.h": headers.encode("ascii")}, "interrupt.h",
        f"{PREFIX}_control_t *state, {PREFIX}_flux_t *observer,"
        f" {PREFIX}_measured_t *measured{extra}",
        f"(void)observer; {observer}return {PREFIX}_{call};",
        f"&state, &observer, &measured, {'dq' if dq else 'r[4]'}", rows(shortened=shortened),
        f"{PREFIX}_abc_t", _STATE + (f" {PREFIX}_dq_t dq;" if dq else ""),
        f"{PREFIX}_control_start(&state);", _ROW + _OBSERVED + (_REFERENCE if dq else ""),
    )  # fmt: skip


def interrupts() -> Iterator[Step]:
    """Current control alone, with the speed loop, and with the observer as well."""
    gains = f"&{PREFIX.upper()}_CONTROL_GAINS"
    told = f"speed_control({gains}, state, measured, reference)"
    seen = (
        f"{PREFIX}_flux_step(&{PREFIX.upper()}_FLUX_GAINS, observer, state->v,"
        f" {PREFIX}_clarke(measured->i)); measured->theta_e = observer->theta_e;"
        f" measured->omega_m = observer->omega_e / {PREFIX.upper()}_CONTROL_GAINS.pole_pairs;\n    "
    )
    for shortened in (False, True):
        current = f"current_control({gains}, state, measured, dq)"
        yield _step("current control", "", current, dq=True, shortened=shortened)
        yield _step("speed loop and current control", "", told, shortened=shortened)
        yield _step(
            "whole interrupt: flux observer, speed loop, current control", seen, told,
            shortened=shortened,
        )  # fmt: skip
