"""A norm in which every step of an observer shrinks a small error: against the emitted step itself
as it runs, by other eigenvalues at other points, and where there is none.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from dqforge.machines.design import catalogue
from dqforge.machines.design.settings import ObserverSettings
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.errors import NoSolutionError
from dqforge.machines.plants.scenario import plants
from dqforge.optimizer.observers.methods.registry import METHODS
from dqforge.optimizer.observers.parts import ObserverState, steady_observer
from dqforge.optimizer.observers.reduced_order import reduced_order_observer, speed_error_factor
from dqforge.optimizer.observers.reduced_order_step import ReducedOrderGains, step
from dqforge.optimizer.observers.step_certificate import (
    ObserverRange,
    StepCertificate,
    certify_step,
    factors,
)
from dqforge.optimizer.observers.tuning import PositionObserver, prove, tune_position_observer
from dqforge.optimizer.steps.step_arithmetic import EXACT

MACHINE = LinearMachine(pole_pairs=3, r_s=0.5, l_d=2e-3, l_q=3e-3, psi_pm=0.1, i_max=20.0)
T_S, HIGH = 2e-4, 1500.0
CHECKED = ["extended-emf", "smo", "open-loop-flux", "matsui-voltage", "matsui-current"]


@cache
def tuned(name: str) -> PositionObserver:
    return tune_position_observer(MACHINE, ObserverSettings(method=name), T_S, 300.0, HIGH)  # type: ignore[arg-type]


def asked(name: str) -> ObserverRange:
    observer = tuned(name)
    i_q = observer.disturbances.i_load
    return ObserverRange(observer.method, observer.gains, MACHINE, T_S, 300.0, HIGH, i_q)


@cache
def found(name: str) -> StepCertificate:
    return certify_step(asked(name), 2_000)


@pytest.mark.parametrize("name", CHECKED)
def test_other_points_shrink_as_stated(name: str) -> None:
    """Drawn speeds and currents; the pencil (A^T P A, P) by a general solver, and the poles."""
    from scipy.linalg import eigh

    certificate, generator = found(name), np.random.default_rng(11)
    omega = generator.uniform(certificate.omega_low, certificate.omega_high, 200)
    i_q = generator.uniform(-1.0, 1.0, 200) * asked(name).i_q
    current = np.asarray(1j * i_q, dtype=np.complex128)
    a = steady_observer(
        METHODS[name], tuned(name).gains, T_S, plants(MACHINE), current, omega
    ).jacobian
    poles = np.abs(np.linalg.eigvals(a))
    assert np.max(poles) < certificate.contraction < 1.0
    own = a[:, certificate.kept][:, :, certificate.kept]
    own = own * certificate.scale[None, None, :] / certificate.scale[None, :, None]
    p = certificate.p
    largest = [eigh(one.T @ p @ one, p, eigvals_only=True)[-1] for one in own]
    assert np.sqrt(np.max(largest)) < certificate.contraction * (1.0 + 1e-4)


@pytest.mark.parametrize("name", ["extended-emf", "smo"])
def test_errors_shrink_while_the_speed_jumps(name: str) -> None:
    """The greedy enemy: of sixty steps the one that leaves the largest error, 300 times."""
    certificate = found(name)
    speeds = np.geomspace(certificate.omega_low, certificate.omega_high, 60)
    table, _ = asked(name).matrices(speeds, np.full(60, 0.5 * asked(name).i_q))
    kept, scale = certificate.kept, certificate.scale
    table = table[:, kept][:, :, kept] * scale[None, None, :] / scale[None, :, None]
    z = np.random.default_rng(3).standard_normal(len(scale))
    value = float(z @ certificate.p @ z)
    for _ in range(300):
        after = table @ z
        values = np.einsum("vi,ij,vj->v", after, certificate.p, after)
        worst = int(np.argmax(values))
        assert values[worst] <= (certificate.contraction * (1.0 + 1e-4)) ** 2 * value
        z, value = after[worst], float(values[worst])


def test_factor_of_a_known_norm() -> None:
    """Diagonal P and matrix, and a turn: by hand."""
    p = np.diag([1.0, 4.0])
    steps = np.array(
        [[[0.5, 0.0], [0.0, 0.25]], [[0.0, 1.0], [0.0, 0.0]], [[0.0, 0.0], [1.0, 0.0]]]
    )
    np.testing.assert_allclose(factors(p, steps), [0.5, 0.5, 2.0], rtol=1e-12)


def test_a_pole_outside_is_named_with_its_place() -> None:
    wild = asked("extended-emf")
    wild = replace(wild, gains=replace(wild.gains, pll=replace(wild.gains.pll, l_1=2.05)))
    with pytest.raises(NoSolutionError, match=r"a pole of modulus 1\.\d+ at [\d.]+ Hz with i_q ="):
        certify_step(wild, 100)


def test_the_sequence_holds_the_corners() -> None:
    own = asked("smo")
    omega, i_q = own.sequence(500)
    corners = {(own.omega_low, own.i_q), (own.omega_low, -own.i_q)}
    corners |= {(own.omega_high, own.i_q), (own.omega_high, -own.i_q)}
    assert corners <= set(zip(omega.tolist(), i_q.tolist(), strict=True))
    assert (np.min(omega), np.max(omega)) == (own.omega_low, own.omega_high)
    assert np.max(np.abs(i_q)) == own.i_q


def test_a_method_without_a_proof_says_why() -> None:
    proof = prove(replace(tuned("smo"), method=METHODS["ekf"]))
    assert proof is not None
    assert (proof.contraction, proof.searched) == (None, False)
    assert "covariance" in proof.reason


def test_speed_observer_by_differences_of_its_step() -> None:
    """The derivative of the emitted step by its own estimate at corners of current and voltage."""
    machine = replace(MACHINE, inertia=2e-3)
    observer = reduced_order_observer(machine, 300.0, T_S)
    gains = ReducedOrderGains.of(machine, observer)
    i_d, v_d = 15.0, 120.0
    worst = 0.0
    for current in (-i_d, i_d):
        for voltage in (-v_d, v_d):
            ends = []
            for error in (-1e-3, 1e-3):
                omega_m = 100.0 + error
                # at the angle zero; the middle of the period is where d of the voltage is meant
                turn = 100.0 * machine.pole_pairs * gains.half_t_s
                v = (voltage * np.cos(turn), voltage * np.sin(turn))
                zeta = omega_m + gains.c * 3.0
                state = ObserverState(
                    ((np.array([current]), np.array([3.0])),),
                    np.zeros(1),
                    np.array([machine.pole_pairs * omega_m]),
                    scalars=(np.array([zeta]), np.array([omega_m])),
                )
                seen = tuple(np.array([part]) for part in v)
                i = (np.array([0.0]), np.array([0.0]))
                after = step(gains, state, seen, i, EXACT, np.zeros(1))  # type: ignore[arg-type]
                ends.append(float(after.scalars[0][0]))
            worst = max(worst, abs(ends[1] - ends[0]) / 2e-3)
    assert speed_error_factor(machine, observer, i_d, v_d) == pytest.approx(worst, rel=1e-6)
    assert worst > observer.a


@pytest.mark.slow
@pytest.mark.parametrize("name", ["extended-emf", "smo", "matsui-current"])
@pytest.mark.parametrize("drive", ["paper001-pmsm-bench", "vdyno-trampa-6340"])
def test_library_drives_at_a_hundred_thousand_drawn_points(drive: str, name: str) -> None:
    from dqforge.optimizer.control_design.gain_set import solve_gains

    design = catalogue.load(drive)
    control = replace(design.control, observer=ObserverSettings(method=name))  # type: ignore[arg-type]
    observer = solve_gains(replace(design, control=control)).position
    assert observer is not None
    proof = prove(observer)
    assert proof is not None
    assert proof.contraction is not None
    own = ObserverRange(
        observer.method, observer.gains, observer.machine, observer.t_s,
        proof.omega_low, proof.omega_high, proof.i_q,
    )  # fmt: skip
    certificate, generator = certify_step(own), np.random.default_rng(5)
    kept, scale = certificate.kept, certificate.scale
    for _ in range(10):
        omega = generator.uniform(proof.omega_low, proof.omega_high, 10_000)
        i_q = generator.uniform(-proof.i_q, proof.i_q, 10_000)
        a, _ = own.matrices(omega, i_q)
        a = a[:, kept][:, :, kept] * scale[None, None, :] / scale[None, :, None]
        assert np.max(factors(certificate.p, a)) < proof.contraction * (1.0 + 1e-5)
