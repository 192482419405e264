"""What an identification says: tables for the terminal, plain data, and the design file that it
leads to.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from dqforge.machines.bench.bench_file import Bench
from dqforge.machines.design.catalogue import load_text
from dqforge.machines.errors import InputError
from dqforge.machines.units.quantities import format_quantity
from dqforge.optimizer.identification.flux_points import FluxTable
from dqforge.optimizer.identification.identify import DESIGN_PARAMETERS, Identification
from dqforge.optimizer.identification.parameters import Analysis, Parameter
from dqforge.reports.pages.answer import Table
from dqforge.reports.plain_data import PlainData, finite


def identification_tables(found: Identification) -> list[Table]:
    """Parameters, what the models leave of each run, and what was found besides."""
    tables = [_parameters(found), _runs(found)]
    for title, texts in (("Contradictions", found.contradictions), ("Remarks", found.remarks)):
        if texts:
            tables.append(Table(title, notes=tuple(texts)))
    return tables


def _parameters(found: Identification) -> Table:
    rows = tuple(
        (
            one.label,
            shown_value(one),
            shown_interval(one),
            one.status,
            one.why,
            ", ".join(f"{key} {correlation:+.2f}" for key, correlation in one.partners),
            ", ".join(one.runs),
        )
        for one in found.parameters
    )
    columns = ("parameter", "value", "95 % interval", "status", "why", "moves with", "runs")
    return Table(f"Parameters of {found.bench.name}", columns, rows)


def shown_value(parameter: Parameter) -> str:
    """The value with its unit, '-' where there is none."""
    if not math.isfinite(parameter.value):
        return "-"
    return format_quantity(parameter.value, parameter.unit, 5)


def shown_interval(parameter: Parameter) -> str:
    """Both ends of the 95 % interval, '-' where there is none."""
    if not math.isfinite(parameter.low):
        return "-"
    low, high = (format_quantity(end, parameter.unit, 4) for end in (parameter.low, parameter.high))
    return f"{low} to {high}"


def _runs(found: Identification) -> Table:
    rows = tuple(
        (
            left.run,
            analysis.name,
            left.quantity,
            str(left.rows),
            f"{left.effective:.3g}",
            format_quantity(left.rms, left.unit, 3),
        )
        for analysis in found.analyses
        for left in analysis.residuals
    )
    columns = ("run", "kind", "quantity", "rows", "independent rows", "left by the model, r.m.s.")
    terms = tuple(
        f"{analysis.name}: {', '.join(analysis.terms)}"
        for analysis in found.analyses
        if analysis.terms
    )
    return Table("Runs", columns, rows, terms)


# Plain data, for JSON and ``result.json``.


def plain_identification(found: Identification) -> PlainData:
    """Parameters, covariances, what the models leave, and the hashes of all that was read."""
    return {
        "bench": {"file": found.bench.source, "sha256": found.bench.digest},
        "logs": _logs(found.bench),
        "parameters": [plain_parameter(one) for one in found.parameters],
        "analyses": [_analysis(one) for one in found.analyses],
        "contradictions": list(found.contradictions),
        "remarks": list(found.remarks),
    }


def _logs(bench: Bench) -> list[PlainData]:
    return [
        {"run": run.name, "kind": run.kind, "file": part.file, "sha256": part.sha256}
        for run in bench.runs
        for part in run.parts
    ]


def plain_parameter(one: Parameter) -> PlainData:
    """A parameter with its interval; null for what has no estimate."""
    return {
        "key": one.key,
        "label": one.label,
        "unit": one.unit,
        "value": finite(one.value),
        "interval_95": [finite(one.low), finite(one.high)],
        "sigma": finite(one.sigma),
        "status": one.status,
        "why": one.why,
        "partners": [{"key": key, "correlation": value} for key, value in one.partners],
        "runs": list(one.runs),
    }


def _analysis(one: Analysis) -> PlainData:
    return {
        "kind": one.name,
        "terms": list(one.terms),
        "keys": [parameter.key for parameter in one.parameters],
        "covariance": [
            [finite(float(value)) for value in row] for row in np.atleast_2d(one.covariance)
        ],
        "residuals": [
            {
                "run": left.run,
                "quantity": left.quantity,
                "unit": left.unit,
                "rms": left.rms,
                "rows": left.rows,
                "independent_rows": left.effective,
            }
            for left in one.residuals
        ],
    }


# The flux map, in columns that a design reads, with what is not known of it.

MAP_NAME = "map.csv"
_MAP_COLUMNS = ("i_d [A]", "i_q [A]", "psi_d [Wb]", "psi_q [Wb]", "sigma_d [Wb]", "sigma_q [Wb]")


def map_csv(table: FluxTable) -> bytes:
    """The map as CSV in UTF-8."""
    columns = (table.i_d, table.i_q, table.psi_d, table.psi_q, table.sigma_d, table.sigma_q)
    lines = [",".join((*_MAP_COLUMNS, "n"))]
    for *values, count in zip(*columns, table.count, strict=True):
        cells = [f"{0.0 if abs(value) < 1e-12 else value:.7g}" for value in values]
        lines.append(",".join((*cells, str(count))))
    return ("\n".join(lines) + "\n").encode()


# The design file: every value with its source and interval.

# Keys of control.tolerances that hold for a design without a speed loop, and the largest deviation
# that is written there.
_TOLERANCES = {
    "resistance": "r_s",
    "inductance_d": "l_d",
    "inductance_q": "l_q",
    "magnet_flux": "psi_pm",
}
_LARGEST_SHARE = 0.9
# What a fitted value takes the place of.
_REPLACED = {
    "magnet_flux": ("magnet_flux", "back_emf_constant", "torque_constant", "kv"),
    "inductance_d": ("inductance_d",),
    "inductance_q": ("inductance_q",),
    "resistance": ("resistance",),
}


def design_of(found: Identification) -> tuple[bytes | None, str]:
    """A design file in UTF-8 that `dqforge check` accepts, or None and what it lacks."""
    if found.contradictions:
        return None, "no design.yaml is written: routes contradict each other"
    data = _design(found)
    text = yaml.safe_dump(data, sort_keys=False, allow_unicode=True, width=100).encode()
    try:
        with tempfile.TemporaryDirectory() as folder:
            if found.flux is not None:
                (Path(folder) / MAP_NAME).write_bytes(map_csv(found.flux.table))
            load_text(text, "design.yaml", Path(folder))
    except InputError as error:
        reason = "; ".join(str(one.message) for one in (error, *error.others))
        return None, f"no design.yaml is written: {reason}; write it under machine or inverter"
    return text, ""


def _design(found: Identification) -> dict[str, Any]:
    bench = found.bench
    machine: dict[str, Any] = {"pole_pairs": bench.entries["machine"]["pole_pairs"]}
    dropped: set[str] = set()
    held = {key: found.of(key) for key, _, _ in DESIGN_PARAMETERS}
    taken = {key: one for key, one in held.items() if one is not None and _is_held(one)}
    single = "inductance" in bench.entries["machine"] and found.flux is None
    if single and ("inductance_d" in taken) != ("inductance_q" in taken):
        # A single inductance of a data sheet stands for the axis that no run holds.
        missing = "inductance_q" if "inductance_d" in taken else "inductance_d"
        machine[missing] = bench.entries["machine"]["inductance"]
    if found.flux is not None:
        dropped = {"inductance", "inductance_d", "inductance_q", *_REPLACED["magnet_flux"]}
        machine = {"model": "flux-map", **machine, "flux_map": {"file": MAP_NAME}}
        taken = {key: one for key, one in taken.items() if key not in dropped}
    for key, one in taken.items():
        machine[key] = _entry(one, bench.source)
    replaced = dropped | {name for key in taken for name in _REPLACED[key]}
    if "inductance_d" in taken or "inductance_q" in taken:
        replaced.add("inductance")
    for key, raw in bench.entries["machine"].items():
        if key not in machine and key not in replaced:
            machine[key] = raw
    tolerances = {
        _TOLERANCES[key]: share
        for key, one in taken.items()
        if key in _TOLERANCES and (share := _tolerance(one))
    }
    design: dict[str, Any] = {"dqforge": 1, "name": bench.name}
    if bench.about:
        design["about"] = bench.about
    design |= {"machine": machine, "inverter": dict(bench.entries["inverter"])}
    if tolerances:
        design["control"] = {"tolerances": tolerances}
    return design


def _is_held(one: Parameter) -> bool:
    return one.status == "identified"


def _entry(one: Parameter, source: str) -> Mapping[str, Any]:
    half = 0.5 * (one.high - one.low)
    runs = ", ".join(one.runs)
    return {
        "value": f"{one.value:.6g} {one.unit}",
        "source": f"dqforge identify, {source}: {runs}"[:200],
        "note": f"95 % interval +- {half:.2g} {one.unit} ({100.0 * half / abs(one.value):.2g} %)",
    }


def _tolerance(one: Parameter) -> dict[str, str] | None:
    """The half interval as a share, one more digit up than it has."""
    share = 0.5 * (one.high - one.low) / abs(one.value)
    if not math.isfinite(share) or share > _LARGEST_SHARE:
        return None
    tenths = math.ceil(1000.0 * share) / 10.0
    return {"value": f"{tenths:.1f} %", "source": "95 % interval of dqforge identify"}
