"""Current references in fixed point as C: plain data, header, test vectors, harness."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from dqforge.machines.units.quantities import format_quantity
from dqforge.optimizer.field_weakening.voltage_region import LEAST_VOLTAGE
from dqforge.optimizer.fixed_reference.fit import FixedReferenceFit
from dqforge.optimizer.steps.integer_arithmetic import CodeArray, Integers
from dqforge.reports.c_code.harness import (
    SWEEP_POINTS,
    SWEEP_SEED,
    Harness,
    HeaderKind,
    Programme,
    integer_kinds,
    title,
)
from dqforge.reports.c_code.numbers import comment_text, int32_literal, rounded_up
from dqforge.reports.capability import Capability, Passage, ReportPart, Rows
from dqforge.reports.pages.answer import Table
from dqforge.reports.pages.html_text import HtmlTable, Row, symbols
from dqforge.reports.pages.templating import REFERENCE, render
from dqforge.reports.single_headers.fixed_mesh_reading import mesh_from
from dqforge.reports.steps.code_arrays import Entries
from dqforge.reports.steps.code_reader import Code
from dqforge.reports.steps.code_text import (
    SHIFTS_KEEP_SIGNS,
    code_reader,
    code_types,
    texts,
    write,
)
from dqforge.reports.steps.record_text import comment, struct

if TYPE_CHECKING:
    from dqforge.machines.design.design import Design
    from dqforge.optimizer.fixed_reference.mesh import CurrentMesh
    from dqforge.optimizer.solution import Solution
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


def _eights(numbers: Sequence[int]) -> list[Sequence[int]]:
    return [numbers[n : n + 8] for n in range(0, len(numbers), 8)]


def _tables(mesh: CurrentMesh, prefix: str) -> tuple[str, CurrentMesh]:
    """The tables of a mesh in C, and the mesh with their names."""
    f, number = mesh.format, f"int{mesh.width}_t"
    rows, nodes = f"{prefix}_reference_torque_{f}", f"{prefix}_reference_nodes_{f}"
    names = ("d", "q") if mesh.voltage is None else ("d", "q", "flux", "heat")
    node = f"{prefix}_reference_node_{f}_t"
    parts = {name: getattr(mesh, name) for name in names}
    values = zip(*parts.values(), strict=True)
    said = "Currents."
    if mesh.voltage is not None:
        said = (
            "Currents, squared flux linkage and squared current, the latter two as squared "
            "voltages."
        )
    text = [
        "/* Torques of the rows. */",
        f"static const {number} {rows}[{mesh.rows + 1}] = {{",
        ",\n".join(f"    {', '.join(map(int32_literal, row))}" for row in _eights(mesh.torque)),
        "};",
        "",
        *comment(said),
        *struct(node, [(f"{number} {name}", "") for name in names]),
        "",
        f"static const {node} {nodes}[{len(mesh.d)}] = {{",
        ",\n".join(f"    {{ {', '.join(map(int32_literal, each))} }}" for each in values),
        "};",
    ]
    named: dict[str, Any] = {
        name: Entries(own, nodes, number, node, name) for name, own in parts.items()
    }
    return "\n".join(text), replace(mesh, torque=Entries(mesh.torque, rows, number), **named)


def _body(design: Design, fit: FixedReferenceFit) -> str:
    """What stands between the guards of the header."""
    mesh, prefix, macro = fit.reference, design.export.prefix, title(design)["macro"]
    begin = f"#define {macro}_REFERENCE_{mesh.format.upper()}"
    tables, own = _tables(mesh, prefix)
    reader, number = code_reader(prefix, mesh.width), Code("number", kind="wide")
    said = f"From a to b by a share of which {1 << mesh.fraction} are 1, to the nearest integer."
    write(reader, own.reference_between, "", *[number] * 3, text=said)
    if mesh.voltage is not None:
        write(reader, own.reference_above, "", *[number] * 3)
    function, given = reader.fixed(own.currents, [number] * 3)
    reader.write("reference", function, given)
    what = " within what dc link and speed allow"
    if mesh.voltage is None:
        what = "; dc link and speed limit nothing"
    lines = ["", *meaning_lines(design, fit)]
    meaning = [f"/* Current references for a torque{what}."]
    meaning += [f" * {comment_text(line)}".rstrip() for line in lines] + [" */", ""]
    functions = reader.functions.texts
    _, _, text = functions["reference"].partition("*/\n")
    functions["reference"] = "\n".join(meaning) + text
    columns = (
        [f"{begin}_COLUMNS ({mesh.columns - 1}U) /* cells along the flux linkage */"]
        if mesh.voltage is not None
        else []
    )
    macros = [
        f"{begin}_ROWS ({mesh.rows}U) /* cells along the torque */",
        *columns,
        f"{begin}_TORQUE_MAX ({mesh.end}) /* code; {mesh.end_torque:.6g} N m */",
    ]
    parts = [SHIFTS_KEEP_SIGNS, code_types(prefix, macro, mesh.width), "\n".join(macros)]
    return "\n\n".join([*parts, tables, texts(reader)])


def _context(design: Design, fit: FixedReferenceFit) -> PlainData:
    return {
        **title(design),
        "part": f"reference_{fit.reference.format}",
        "subject": "current references in fixed point",
        "preamble": preamble_lines(design, fit),
        "includes": ["<stdint.h>"],
        "body": _body(design, fit),
        "vectors": True,
    }


def reference_files(design: Design, fit: FixedReferenceFit) -> dict[str, bytes]:
    """Names and bytes of the header in one fixed-point format, and of its test vectors."""
    mesh = fit.reference
    inputs = reference_inputs(mesh, design.export.vectors, _SEED)
    rows = np.concatenate([inputs, reference_results(mesh, inputs)], axis=1)
    text = render("c_code/header.h.j2", _context(design, fit))
    return mesh_harness(mesh).files(design, text, rows)


def mesh_harness(mesh: CurrentMesh) -> Harness:
    """What the header does with a row of codes."""
    number, f = f"int{mesh.width}_t", mesh.format
    return Harness(
        f"reference_{f}",
        "codes of torque, DC-link voltage and speed; i_d and i_q",
        (3, 2),
        (
            f"const @_dq_{f}_t found = @_reference_{f}(in[0], in[1], in[2]);",
            "",
            "out[0] = found.d;",
            "out[1] = found.q;",
        ),
        number,
    )


def reference_programme(mesh: CurrentMesh) -> Programme:
    """The harness of a reference on many codes."""
    inputs = reference_inputs(mesh, SWEEP_POINTS, SWEEP_SEED)
    number = np.dtype(f"i{mesh.width // 8}")
    results = reference_results(mesh, inputs).astype(number)
    return Programme(mesh_harness(mesh), inputs.astype(number), results, "fixed-point reference")


# Current references in fixed point in words, for the header, the terminal and the report.


def percent(share: float) -> str:
    """A share in percent, rounded up, at least 0."""
    return f"{rounded_up(100.0 * max(share, 0.0))} %"


def size_words(fit: FixedReferenceFit) -> str:
    """Cells and bytes of the tables."""
    mesh = fit.reference
    across = f" x {mesh.columns - 1}" if mesh.voltage is not None else ""
    cells = "cell" if (mesh.rows, across) == (1, "") else "cells"
    return f"{mesh.rows}{across} {cells}, {mesh.table_bytes} B of tables"


def error_words(fit: FixedReferenceFit) -> str:
    """The largest errors in one line."""
    errors = fit.errors
    over = errors.voltage_excess
    voltage = "" if over is None else f", voltage +{percent(over)}"
    return (
        f"torque {percent(errors.torque_relative)}{voltage}, current "
        f"+{percent(errors.current_excess)}, copper loss +{percent(errors.loss_relative)}"
    )


def preamble_lines(design: Design, fit: FixedReferenceFit) -> list[str]:
    """What the header is, as lines of a comment."""
    mesh, fullest = fit.reference, fit.fullest
    current, voltage, speed, torque = mesh.bases
    bits = mesh.width
    link = "; the dc link is not looked at."
    if mesh.voltage is not None:
        full = voltage * mesh.voltage.limit.value / (design.v_max / design.inverter.v_dc)
        link = f", {full:.6g} V of the dc link."
    return [
        f"Codes are int{bits}_t, 2^{bits - 1} of them full scale: {torque:.6g} N m of torque,",
        f"{current:.6g} A (peak) of current, {speed:.6g} rad/s of mechanical speed{link}",
        f"{size_words(fit)}. Plain C99 and C++11 in integers, no library function.",
        (
            f"No overflow for any codes: {len(fit.reaches)} products and sums proven by interval "
            "analysis;"
        ),
        f"the fullest, '{fullest.name}', reaches {fullest.share:.4%} of int{2 * bits}_t.",
    ]


def meaning_lines(design: Design, fit: FixedReferenceFit) -> list[str]:
    """What goes in, what comes out and what it errs by, as lines of a comment."""
    mesh, errors = fit.reference, fit.errors
    lines = [
        f"torque: either sign, held to +-{mesh.end_torque:.6g} N m; i_q has its sign.",
        "Between exact operating points the currents are linear.",
    ]
    if mesh.voltage is not None:
        lines += _voltage_lines(design, fit)
    else:
        lines.append("v_dc and omega_m are not looked at.")
    lines += [
        "",
        f"Errors against exact operating points, sampled at {errors.samples} points:",
        (
            f"torque at most {rounded_up(errors.torque)} N m, {percent(errors.torque_relative)} of "
            f"the largest; currents at most {rounded_up(errors.current)} A away;"
        ),
        f"copper loss at most {percent(errors.loss_relative)} above the least, from 5 % torque up.",
        (
            f"Proven: the current exceeds its limit of {design.i_max:.6g} A by at most "
            f"{percent(fit.proven.current)}."
        ),
    ]
    return lines


def _voltage_lines(design: Design, fit: FixedReferenceFit) -> list[str]:
    """What holds where the field is weakened."""
    over, speed = fit.errors.voltage_excess, fit.speed
    assert over is not None
    assert speed is not None
    share = design.v_max / design.inverter.v_dc
    what = "The phase voltage, resistance drop included, exceeds that by"
    kept = [f"{what} {percent(over)} (sampled)."]
    if fit.proven.voltage is not None:
        kept = [
            f"{what} at most {percent(fit.proven.voltage)}: proven",
            (
                f"from {100.0 * LEAST_VOLTAGE:g} % of the dc link up, for speeds in proportion to "
                f"it ({percent(over)} found by sampling)."
            ),
        ]
    return [
        f"v_dc: of it {share:.6g} is the largest phase amplitude. omega_m: either sign.",
        (
            f"Made up to {format_quantity(speed, 'rpm', 5)} at {design.inverter.v_dc:.6g} V; at "
            "other voltages in proportion. The torque is"
        ),
        "reduced where it cannot be had, beyond the largest speed down to none.",
        *kept,
        f"The phase resistance is {design.machine.r_s:.6g} Ohm in what follows: take it warm.",
    ]


# Current references in fixed point, as a record.

Fits = tuple[FixedReferenceFit, ...]


_KINDS: tuple[HeaderKind[Fits, CurrentMesh], ...] = integer_kinds(
    "reference",
    width_of=lambda fit: fit.reference.width,
    files=lambda solution, fit: reference_files(solution.design, fit),
    plain=lambda fit: plain_mesh(fit.reference),
    read=lambda own, width, _: mesh_from(own, width),
    programme=reference_programme,
)


def _summary(_: Solution, fits: Fits) -> Rows:
    return [
        (f"reference {fit.reference.format}", f"{size_words(fit)}; {error_words(fit)}")
        for fit in fits
    ]


def _plain(_: Solution, fits: Fits) -> PlainData:
    return {fit.reference.format: _evidence(fit) for fit in fits}


def _evidence(fit: FixedReferenceFit) -> PlainData:
    errors, mesh, fullest = fit.errors, fit.reference, fit.fullest
    return {
        "rows": mesh.rows,
        "columns": mesh.columns - 1,
        "bytes": mesh.table_bytes,
        "torque_max_Nm": mesh.end_torque,
        "omega_m_rad_per_s": fit.speed,
        "errors": {
            "torque_Nm": errors.torque,
            "torque_relative": errors.torque_relative,
            "current_A": errors.current,
            "current_excess": errors.current_excess,
            "voltage_excess": errors.voltage_excess,
            "loss_relative": errors.loss_relative,
            "samples": errors.samples,
        },
        "proven": {
            "current_excess": fit.proven.current,
            "voltage_excess": fit.proven.voltage,
        },
        "ranges": [
            {"name": reach.name, **asdict(reach.range), "bits": reach.bits} for reach in fit.reaches
        ],
        "fullest": {"name": fullest.name, "share": fullest.share},
    }


def _parts(_: Solution, fits: Fits) -> list[ReportPart]:
    return [Passage(tables=reference_html(fits), kind="reference").of(REFERENCE)]


FIXED_REFERENCE = Capability(
    name="reference_fixed",
    title="current references in fixed point",
    of=lambda outcome: outcome.solution.fixed_references or None,
    plain=_plain,
    always=False,
    summary=_summary,
    tables=lambda _, fits: reference_tables(fits),
    parts=_parts,
    headers=_KINDS,
)


# Current references in fixed point on the terminal and in the report.

_TITLE = "Current references in fixed point"


_COLUMNS = (
    "format",
    "cells",
    "bytes",
    "up to N m",
    "torque error",
    "voltage excess",
    "current excess",
    "currents off by A",
    "loss above the least",
    "fullest word",
)


def _cells(fit: FixedReferenceFit) -> tuple[str, ...]:
    mesh, errors = fit.reference, fit.errors
    voltage = "-" if errors.voltage_excess is None else percent(errors.voltage_excess)
    return (
        mesh.format,
        f"{mesh.rows}" if mesh.voltage is None else f"{mesh.rows} x {mesh.columns - 1}",
        f"{mesh.table_bytes}",
        f"{mesh.end_torque:.6g}",
        percent(errors.torque_relative),
        voltage,
        percent(errors.current_excess),
        rounded_up(errors.current),
        percent(errors.loss_relative),
        f"{fit.fullest.share:.3%}",
    )


def reference_tables(fits: Sequence[FixedReferenceFit]) -> list[Table]:
    """One row per fixed-point format, for the terminal."""
    note = (
        "errors against exact operating points, sampled; where the field is weakened motoring and "
        "generating at 0.8 to 1.1 of the voltage"
    )
    return [Table(_TITLE, _COLUMNS, tuple(_cells(fit) for fit in fits), (note,))]


def reference_html(fits: Sequence[FixedReferenceFit]) -> list[HtmlTable]:
    """The same for the report."""
    rows = tuple(Row(_cells(fit), "") for fit in fits)
    return [HtmlTable(_TITLE, tuple(symbols(text) for text in _COLUMNS), rows)]
