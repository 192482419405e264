"""The emitted correction: its bound under any inputs, its counters, its words, and the drive that
runs on it.
"""

from __future__ import annotations

import json
import math
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from learned_drives import learned_observer, observed_template
from static_checks import program

from dqforge.machines.design import catalogue
from dqforge.machines.design.catalogue import load_text
from dqforge.machines.errors import InputError
from dqforge.machines.names import LEARNED_OBSERVERS, ObserverMethodName
from dqforge.machines.plants.scenario import PlantErrors, Scenario, constant
from dqforge.optimizer.curves.single_precision import SINGLE
from dqforge.optimizer.solution import solve
from dqforge.optimizer.steps.step_arithmetic import cast
from dqforge.reports.observers.float32_model import observer_inputs
from dqforge.reports.observers.position_header import observer_files
from dqforge.reports.observers.position_text import plain_position, position_parts
from dqforge.reports.pages.templating import to_text
from dqforge.reports.simulation.design_run import (
    angle_error,
    controller_files,
    drive_of,
    observers_of,
)
from dqforge.reports.simulation.recorded_run import simulate, simulator

EVERY = pytest.mark.parametrize("method", LEARNED_OBSERVERS)

# Random states and samples, a million of them: whatever stands in flux, angle, speed and current,
# the correction stays within its limit, and where it is silent it is nought.
BOUNDS = r"""
#include <stdio.h>
#include "motor1_observer.h"

static unsigned int seed = 12345U;

static float between(float low, float high)
{
    seed = (seed * 1664525U) + 1013904223U;
    return low + ((high - low) * ((float)(seed >> 8) / 16777216.0F));
}

int main(void)
{
    motor1_@_gains_t gains = MOTOR1_UPPER_GAINS;
    motor1_@_t observer;
    float largest = 0.0F;
    long acted = 0L;
    long wrong = 0L;
    long n;

    gains.frame.share = 1.0F; /* no filter: the correction is what was learned */
    for (n = 0L; n < 1000000L; n++) {
        const float wild = ((n % 10L) == 0L) ? 1.0e4F : 1.0F;
        const float volts = 100.0F * wild;
        const float amperes = 7.0F * wild;
        const motor1_alphabeta_t v = { between(-volts, volts), between(-volts, volts) };
        const motor1_alphabeta_t i = { between(-amperes, amperes), between(-amperes, amperes) };
        const float angle = between(-3.2F, 3.2F);
        const motor1_rotation_t near = motor1_rotation(angle + between(-0.05F, 0.05F));

        motor1_@_start(&observer, angle, wild * between(-2000.0F, 2000.0F));
        observer.started = 1;
        observer.i = i;
        observer.psi = motor1_flux_of_current(
            gains.flux.l_d, gains.flux.l_q, gains.flux.psi_pm, i, near);
        observer.psi.alpha += wild * between(-0.02F, 0.02F);
        observer.psi.beta += wild * between(-0.02F, 0.02F);
        if ((n % 1000L) == 7L) {
            observer.psi.alpha = (n % 2000L == 7L) ? (0.0F / (angle - angle)) : 3.0e38F;
        }
        motor1_@_step(&gains, &observer, v, i);
        if (observer.outside == 0.0F) {
            acted++;
        } else if (observer.correction != 0.0F) {
            wrong++;
        }
        if (!(fabsf(observer.correction) <= gains.frame.limit)) {
            wrong++;
        }
        if ((observer.hits != 0.0F) != (observer.outside == 0.0F)) {
            wrong++;
        }
        if (observer.correction > largest) {
            largest = observer.correction;
        }
    }
    printf("%ld %ld %.9g %.9g\n", wrong, acted, (double)largest, (double)gains.frame.limit);
    return 0;
}
"""


def compiled(folder: Path, method: ObserverMethodName, text: str, limit: float | None) -> Path:
    """A program around the emitted header; with the limit of its correction in rad, if given."""
    observer = learned_observer(method)
    if limit is not None:
        frame = replace(observer.gains.frame, limit=float(np.float32(limit)))
        observer = replace(observer, gains=replace(observer.gains, frame=frame))
    for name, content in observer_files(observed_template(method), observer).items():
        (folder / name).write_bytes(content)
    code = observer.method.code
    (folder / "main.c").write_text(text.replace("@", code).replace("UPPER", code.upper()), "ascii")
    flags = ["-std=c99", "-O1", "-Wall", "-Wextra", "-Werror", "-ffp-contract=off"]
    subprocess.run(
        [program("gcc"), *flags, "main.c", "-o", "bounds", "-lm"], cwd=folder, check=True
    )
    return folder / "bounds"


@pytest.mark.slow
@EVERY
@pytest.mark.parametrize("limit", [None, 0.1])
def test_no_input_of_a_million_leads_beyond_the_limit(
    method: ObserverMethodName, limit: float | None, tmp_path: Path
) -> None:
    """With the limit of the training, and with one that is reached often."""
    run = subprocess.run(
        [compiled(tmp_path, method, BOUNDS, limit)], capture_output=True, text=True, check=True
    )
    wrong, acted, largest, most = (float(word) for word in run.stdout.split())
    assert wrong == 0
    assert acted > 50_000
    assert largest <= most
    if limit is not None:
        assert largest > 0.5 * most


@EVERY
def test_verification_reaches_the_correction(method: ObserverMethodName) -> None:
    """In the sequences that compare C and model the correction acts and is silent, both often."""
    observer = learned_observer(method)
    own = cast(observer.gains, SINGLE)
    rows = observer_inputs(observer.method, observer.gains, 20_000, 5).reshape(-1, 100, 7)
    state = observer.method.start(rows[:, 0, 1].copy(), rows[:, 0, 2].copy())
    acted = []
    with np.errstate(all="ignore"):
        for k in range(100):
            v_alpha, v_beta, i_alpha, i_beta = (rows[:, k, n].copy() for n in range(3, 7))
            state = observer.method.step(own, state, (v_alpha, v_beta), (i_alpha, i_beta), SINGLE)
            acted.append(float(np.mean(state.scalars[2] == 0.0)))
    assert 0.02 < np.mean(acted) < 0.98


@EVERY
def test_what_is_gained_and_where_nothing_is_known_stands_everywhere(
    method: ObserverMethodName,
) -> None:
    observer = learned_observer(method)
    training = observer.training
    assert training is not None
    title, columns, rows, notes = position_parts(observer)[-1]
    assert title.startswith("Learned correction")
    assert len(rows) == 4
    assert all(len(row) == len(columns) for row in rows)
    corrected = columns.index("corrected")
    assert rows[1][corrected].startswith(f"{math.degrees(training.rms['corrected'][1]):.3g} (")
    assert any("no correction below 7.5 Hz" in note for note in notes)
    bound = next(note for note in notes if note.startswith("limited to"))
    assert ("largest of them" in bound) == (method == "neuro-fuzzy")
    assert ("nothing more is proven" in bound) == (method == "neural")
    (header,) = observer_files(observed_template(method), observer).values()
    assert " ".join(header.decode().replace(" *", " ").split()).count(bound) == 1
    plain = json.loads(to_text("tune", "test", {"position": plain_position(observer)}))["position"]
    told = plain["training"]
    assert told["rms_rad"]["corrected"] == pytest.approx(training.rms["corrected"].tolist())
    assert (told["rules_rad"] is None) == (method == "neural")


def _mean_error(method: ObserverMethodName, share: float, torque: float) -> float:
    """Angle error in deg of the simulated drive, R 30 % larger than the design says."""
    solution = solve(observed_template(method))
    design, observer = solution.design, solution.gains.position
    assert observer is not None
    speed = constant(share * observer.omega_max / design.machine.pole_pairs)
    scenario = Scenario(
        1.0,
        "torque",
        constant(torque * solution.fit.torque_max),
        shaft=speed,
        omega_m=speed.values[0],
        errors=PlantErrors(r_s=0.3),
    )
    with simulator(
        controller_files(solution), design.export.prefix, observers_of(solution)[1]
    ) as run:
        found = simulate(run, drive_of(design), scenario)
    late = found.t > 0.7
    return math.degrees(float(np.angle(np.mean(np.exp(1j * angle_error(found)[late])))))


POINTS = [(0.1, 0.5), (0.2, 0.5), (0.1, 0.9)]


@pytest.mark.slow
@pytest.mark.parametrize(("share", "torque"), POINTS)
def test_a_warm_drive_runs_on_a_better_angle(share: float, torque: float) -> None:
    """The rules take R and the whole dead time together for more of either and err by as much to
    the other side: their gain is one of the mean.
    """
    before = _mean_error("flux", share, torque)
    after = _mean_error("neuro-fuzzy", share, torque)
    assert before > 3.0
    assert abs(after - before) > 3.0
    assert abs(after) < 1.6 * before


@pytest.mark.slow
@pytest.mark.parametrize(("share", "torque"), POINTS)
def test_the_network_leaves_less_than_half_of_the_error(share: float, torque: float) -> None:
    assert abs(_mean_error("neural", share, torque)) < 0.5 * _mean_error("flux", share, torque)


def test_keys_are_read_and_refused_where_they_do_not_belong() -> None:
    text = _text("{method: neural, hidden_layers: [4, 16], correction_filter: 50 ms, "
                 "correction_limit: 20 deg}")  # fmt: skip
    observer = load_text(text, "drive.yaml").control.observer
    assert observer is not None
    assert observer.hidden_layers == (4, 16)
    assert observer.correction_filter == pytest.approx(0.05)
    assert observer.correction_limit == pytest.approx(math.radians(20.0))
    for wrong, words in (
        ("{method: flux, correction_limit: 20 deg}", "'flux' does not use 'correction_limit'"),
        ("{method: neuro-fuzzy, hidden_layers: [8, 8]}", "does not use 'hidden_layers'"),
        ("{method: neural, hidden_layers: [8, 17]}", "hidden_layers"),
        ("{method: neural, hidden_layers: [8]}", "hidden_layers"),
        ("{method: neural, correction_limit: 120 deg}", "correction_limit"),
    ):
        with pytest.raises(InputError, match=words):
            load_text(_text(wrong), "drive.yaml")


@EVERY
@pytest.mark.parametrize("width", ["q15", "q31"])
def test_integers_are_refused_in_one_line(method: ObserverMethodName, width: str) -> None:
    text = _text(f"{{method: {method}}}", f"  control: [float32, {width}]\n")
    with pytest.raises(InputError, match="is not there in fixed point; write") as refused:
        load_text(text, "drive.yaml")
    assert "\n" not in str(refused.value)


def _text(observer: str, control: str = "") -> bytes:
    """The template with another observer, and what its header is to hold."""
    text = catalogue.template().decode()
    found = text.replace("  observer:\n    pole: 400 rad/s\n", f"  observer: {observer}\n")
    assert found != text
    return found.replace("export:\n", f"export:\n{control}").encode()
