"""The harness of the current reference: inputs, and results of the model."""

from __future__ import annotations

import numpy as np

from dqforge.optimizer.current_reference.forms import Emitted, FloatReference
from dqforge.optimizer.current_reference.integer_form import FixedReference
from dqforge.optimizer.curves.integer_polynomial import CodeArray
from dqforge.optimizer.curves.single_precision import SingleArray
from dqforge.reports.c_code.harness import Programme
from dqforge.reports.c_code.header_kind import SWEEP_POINTS, SWEEP_SEED
from dqforge.reports.current_reference.evaluator import vector_codes, vector_torques


def sweep_torques(reference: FloatReference, count: int = SWEEP_POINTS) -> SingleArray:
    """Float32 torques beyond the test vectors: across the domain of both signs,
    and raw bit patterns of any kind.
    """
    generator = np.random.default_rng(SWEEP_SEED)
    across = (generator.uniform(-1.1, 1.1, count // 2) * float(reference.torque_max)).astype(
        np.float32
    )
    patterns = generator.integers(0, 2**32, count - across.size, dtype=np.uint32).view(np.float32)
    return np.concatenate([across, patterns])


def sweep_codes(reference: FixedReference, count: int = SWEEP_POINTS) -> CodeArray:
    """All codes of 16 bits, or so many random ones of 32 bits, half of them inside the domain."""
    most = 2 ** (reference.width - 1)
    if reference.width <= 16:
        return np.arange(-most, most)
    generator = np.random.default_rng(SWEEP_SEED)
    inside = generator.integers(-reference.end, reference.end + 1, count // 2)
    return np.concatenate([inside, generator.integers(-most, most, count - inside.size)])


def reference_programme(reference: Emitted, vectors: int) -> tuple[Programme, int]:
    """The harness of the current reference with its inputs, and how many
    of these are test vectors.
    """
    if isinstance(reference, FixedReference):
        chosen = vector_codes(reference, vectors)
        codes = np.concatenate([chosen, sweep_codes(reference)])
        number = np.dtype(f"i{reference.width // 8}")
        context = {"width": reference.width, "format": reference.format}
        results = np.stack(reference.codes(codes), axis=1).astype(number)
        return Programme(
            "current_reference/fixed_harness.c.j2", codes.astype(number), results, context
        ), chosen.size
    special = vector_torques(reference, vectors)
    torque = np.concatenate([special, sweep_torques(reference)])
    return Programme(
        "current_reference/harness.c.j2", torque, np.stack(reference.currents(torque), axis=1)
    ), special.size
