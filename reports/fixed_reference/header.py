"""Current references in fixed point as C: plain data, header, test vectors, harness."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING

import numpy as np

from dqforge.optimizer.fixed_control.arithmetic import CodeArray, Integers
from dqforge.reports.c_code.harness import Programme
from dqforge.reports.c_code.header_kind import SWEEP_POINTS, SWEEP_SEED
from dqforge.reports.c_code.title import title
from dqforge.reports.fixed_reference.text import meaning_lines, preamble_lines
from dqforge.reports.pages.templating import render

if TYPE_CHECKING:
    from dqforge.machines.design.design import Design
    from dqforge.optimizer.fixed_reference.fit import FixedReferenceFit
    from dqforge.optimizer.fixed_reference.mesh import CurrentMesh
    from dqforge.reports.plain_data import PlainData

_SEED = 20_261_122


def plain_mesh(mesh: CurrentMesh) -> PlainData:
    """The integers as plain data."""
    return asdict(mesh)


def reference_inputs(mesh: CurrentMesh, count: int, seed: int) -> CodeArray:
    """Codes of torque, dc link and speed, shape (count, 3): a third of them about the rows of the
    mesh, the ends of their words among all of them.
    """
    generator = np.random.default_rng(seed)
    low, high = -(2 ** (mesh.width - 1)), 2 ** (mesh.width - 1) - 1
    rows = generator.integers(low, high, (count, 3), endpoint=True)
    special = generator.choice(np.array([low, low + 1, -1, 0, 1, high - 1, high]), (count, 3))
    rows = np.where(generator.random((count, 3)) < 0.1, special, rows)
    third = count // 3
    edges = np.array(mesh.torque)[generator.integers(0, mesh.rows, third, endpoint=True)]
    edges = (edges + generator.integers(-1, 2, third)) * generator.choice([-1, 1], third)
    rows[:third, 0] = np.clip(edges, low, high)
    return np.asarray(rows.astype(np.int64))


def reference_results(mesh: CurrentMesh, inputs: CodeArray) -> CodeArray:
    """What the compiled function must return for inputs, shape (N, 2)."""
    found = mesh.currents(Integers(), *inputs.T)
    return np.stack([found.x, found.y], axis=1)


def _nodes(mesh: CurrentMesh) -> list[tuple[int, ...]]:
    columns = [mesh.d, mesh.q]
    if mesh.voltage is not None:
        columns += [mesh.flux, mesh.heat]
    return list(zip(*columns, strict=True))


def _context(design: Design, fit: FixedReferenceFit) -> PlainData:
    mesh = fit.reference
    return {
        **title(design),
        "format": mesh.format,
        "width": mesh.width,
        "top": mesh.top,
        "rows": mesh.rows,
        "columns": mesh.columns,
        "end": mesh.end,
        "end_torque": f"{mesh.end_torque:.6g}",
        "torque": mesh.torque,
        "nodes": _nodes(mesh),
        "voltage": None if mesh.voltage is None else asdict(mesh.voltage),
        "preamble": preamble_lines(design, fit),
        "comment": meaning_lines(design, fit),
    }


def reference_files(design: Design, fit: FixedReferenceFit) -> dict[str, bytes]:
    """Names and bytes of the header in one fixed-point format, and of its test vectors."""
    context, mesh = _context(design, fit), fit.reference
    inputs = reference_inputs(mesh, design.export.vectors, _SEED)
    rows = np.concatenate([inputs, reference_results(mesh, inputs)], axis=1).tolist()
    name = f"{design.export.prefix}_reference_{mesh.format}"
    texts = {
        f"{name}.h": render("fixed_reference/reference.h.j2", context),
        f"{name}_vectors.h": render("fixed_reference/vectors.h.j2", context | {"vectors": rows}),
    }
    return {file: text.encode("ascii") for file, text in texts.items()}


def reference_programme(mesh: CurrentMesh) -> Programme:
    """The harness of a reference on many codes."""
    inputs = reference_inputs(mesh, SWEEP_POINTS, SWEEP_SEED)
    number = np.dtype(f"i{mesh.width // 8}")
    return Programme(
        "fixed_reference/harness.c.j2",
        inputs.astype(number),
        reference_results(mesh, inputs).astype(number),
        {"width": mesh.width, "format": mesh.format},
        name="fixed-point reference",
    )
