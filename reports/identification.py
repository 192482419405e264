"""What an identification says: tables for the terminal, plain data, and the design file that it
leads to.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import numpy as np
import yaml

from dqforge.machines.bench.bench_file import Bench
from dqforge.machines.design.catalogue import load_text
from dqforge.machines.design.design import Design
from dqforge.machines.errors import InputError
from dqforge.machines.files.scratch import scratch_folder
from dqforge.machines.transforms import in_rpm
from dqforge.machines.units.quantities import format_quantity
from dqforge.optimizer.identification.bench_plan import BenchPlan
from dqforge.optimizer.identification.flux_points import FluxFit, FluxTable
from dqforge.optimizer.identification.identify import DESIGN_PARAMETERS, Identification
from dqforge.optimizer.identification.parameters import Analysis, Parameter
from dqforge.reports.pages.answer import Table
from dqforge.reports.plain_data import PlainData, finite


def identification_tables(found: Identification) -> list[Table]:
    """Parameters, those that the runs do not hold, what the models leave of each run, and what was
    found besides.
    """
    tables = [_parameters(found), *_not_held(found), _runs(found)]
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
            one.status if not one.why else f"{one.status}: {one.why}",
            ", ".join(one.runs),
            ", ".join(f"{key} {correlation:+.2f}" for key, correlation in one.partners),
        )
        for one in found.parameters
        if one.status != _NOT_HELD
    )
    columns = ("parameter", "value", "95 % interval", "status", "runs", "moves with")
    return Table(f"Parameters of {found.bench.name}", columns, rows)


_NOT_HELD = "not identified"
NOT_HELD = "Not identified"


def _not_held(found: Identification) -> list[Table]:
    """What the runs do not hold, and why."""
    rows = tuple(
        (one.label, shown_value(one), one.why)
        for one in found.parameters
        if one.status == _NOT_HELD
    )
    return [Table(NOT_HELD, ("parameter", "value", "why"), rows)] if rows else []


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
    number, _, unit = low.partition(" ")
    return f"{number if unit == high.partition(' ')[2] else low} to {high}"


def _runs(found: Identification) -> Table:
    rows = tuple(
        (
            left.run,
            analysis.name,
            left.quantity,
            str(left.rows),
            f"{left.effective:.0f}",
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
        "flux_map": None if found.flux is None else _plain_flux(found.flux),
        "contradictions": list(found.contradictions),
        "remarks": list(found.remarks),
    }


def _plain_flux(flux: FluxFit) -> PlainData:
    curl = flux.curl
    return {
        "points": int(flux.table.i_d.size),
        "curl_H": None if curl is None else curl.rms,
        "cross_inductance_H": None if curl is None else curl.cross,
        "spline_one_out_Vs": flux.one_out,
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
        "leave_one_out": None
        if one.moved is None
        else {"run": one.moved[0], "moves_sigma": one.moved[1]},
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
    """The map as CSV in UTF-8: with parts of the deviations that all points share."""
    columns = [table.i_d, table.i_q, table.psi_d, table.psi_q, table.sigma_d, table.sigma_q]
    names = [*_MAP_COLUMNS, "n"]
    for number, parts in enumerate(table.shared, 1):
        names += [f"shared_{number}_{axis} [Wb]" for axis in "dq"]
        columns += list(parts)
    lines = [",".join(names)]
    for values, count in zip(zip(*columns, strict=True), table.count, strict=True):
        cells = [f"{0.0 if abs(value) < 1e-12 else value:.7g}" for value in values]
        lines.append(",".join((*cells[:6], str(count), *cells[6:])))
    return ("\n".join(lines) + "\n").encode()


# The plan of a bench: a sheet of points, and the bench file that reads them back.

SHEET, BENCH_FILE = "points.csv", "bench.yaml"
_SHEET_COLUMNS = ("point", "speed_rpm", "i_d_A", "i_q_A", "seconds", "u_d_V", "u_q_V")


def plan_sheet(plan: BenchPlan) -> bytes:
    """The points in their order as CSV; the voltages are to be filled in."""
    lines = [",".join(_SHEET_COLUMNS)]
    for number, point in enumerate(plan.points, 1):
        cells = (in_rpm(point.omega_m), point.i_d, point.i_q, point.seconds)
        texts = (f"{0.0 if abs(cell) < 1e-9 else cell:.5g}" for cell in cells)
        lines.append(",".join((str(number), *texts, "", "")))
    return ("\n".join(lines) + "\n").encode()


def plan_bench_file(design: Design) -> bytes:
    """A bench file that reads the filled sheet, with what the design knows."""
    machine, inverter = design.machine, design.inverter
    data = {
        "dqforge_bench": 1,
        "name": design.name,
        "machine": {
            "pole_pairs": machine.pole_pairs,
            "max_current": f"{design.i_max:.6g} A peak",
            "resistance": f"{machine.r_s:.6g} Ohm",
            "magnet_flux": f"{machine.psi_pm:.6g} Wb",
        },
        "inverter": {
            "v_dc": f"{inverter.v_dc:.6g} V",
            "switching_frequency": f"{inverter.f_sw:.6g} Hz",
        },
        "runs": [
            {
                "name": "points",
                "kind": "constant-speed",
                "file": SHEET,
                "columns": {name: name for name in ("i_d", "i_q", "u_d", "u_q", "speed")},
                "currents": "measured",
                "voltage": "reference",
            }
        ],
    }
    head = (
        "# Write over the columns of points.csv what was measured at each point: currents, mean\n"
        "# voltages (or references: say which below) and speed; then dqforge identify bench.yaml\n"
    )
    return (head + yaml.safe_dump(data, sort_keys=False, allow_unicode=True, width=100)).encode()


def plan_tables(plan: BenchPlan) -> list[Table]:
    """What to expect of the points, and how many it takes."""
    rows = tuple(
        (
            one.label,
            format_quantity(one.value, one.unit),
            f"+- {format_quantity(one.half, one.unit, 2)}",
            f"{100.0 * one.half / one.value:.2g} %" if one.value > 0.0 else "-",
        )
        for one in plan.expected
    )
    noise = format_quantity(plan.noise, "V", 2)
    minutes = sum(point.seconds for point in plan.points) / 60.0
    counts = ", ".join(
        f"{count} for {100.0 * share:g} %" for share, count in plan.least_points.items()
    )
    notes = (
        f"{len(plan.points)} points in {minutes:.2g} min, both directions and signs of i_q in turn "
        "so that the winding is as warm in one quadrant as in the other"
        + (f"; {plan.left_out} beyond the voltage limit are left out" if plan.left_out else ""),
        f"largest torque within {100.0 * plan.torque:.2g} %; points needed for it: {counts}",
        f"mean voltages are taken to have a standard deviation of {noise}",
    )
    heads = ("parameter", "before", "95 % interval to expect", "of the value")
    return [Table("Expected of the points", heads, rows, notes)]


def plain_plan(plan: BenchPlan) -> PlainData:
    """The same as plain data."""
    return {
        "points": [asdict(point) for point in plan.points],
        "left_out": plan.left_out,
        "noise_V": plan.noise,
        "expected": [asdict(one) for one in plan.expected],
        "torque": plan.torque,
        "least_points": [
            {"torque": share, "points": count} for share, count in plan.least_points.items()
        ],
    }


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
}


def design_of(found: Identification) -> tuple[bytes | None, str]:
    """A design file in UTF-8 that `dqforge check` accepts, or None and what it lacks."""
    if found.contradictions:
        return None, "no design.yaml is written: routes contradict each other"
    data = _design(found)
    text = yaml.safe_dump(data, sort_keys=False, allow_unicode=True, width=100).encode()
    try:
        with scratch_folder() as folder:
            if found.flux is not None:
                (folder / MAP_NAME).write_bytes(map_csv(found.flux.table))
            load_text(text, "design.yaml", folder)
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
    replaced = dropped | {name for key in taken for name in _REPLACED.get(key, (key,))}
    if "inductance_d" in taken or "inductance_q" in taken:
        replaced.add("inductance")
    for key, raw in bench.entries["machine"].items():
        if key not in machine and key not in replaced:
            machine[key] = raw
    tolerances = {
        _TOLERANCES[key]: share
        for key, one in held.items()
        if key in _TOLERANCES and key not in dropped and one and (share := _tolerance(one))
    }
    design: dict[str, Any] = {"dqforge": 1, "name": bench.name}
    if bench.about:
        design["about"] = bench.about
    design |= {"machine": machine, "inverter": dict(bench.entries["inverter"])}
    if tolerances:
        design["control"] = {"tolerances": tolerances}
    return design


def _is_held(one: Parameter) -> bool:
    """Whether the runs have a part in the value."""
    return one.status == "identified" or (one.status == "prior-dominated" and bool(one.runs))


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
    if one.status == "not identified":
        return None
    share = 0.5 * (one.high - one.low) / abs(one.value)
    if not math.isfinite(share) or share > _LARGEST_SHARE:
        return None
    tenths = math.ceil(1000.0 * share) / 10.0
    return {"value": f"{tenths:.1f} %", "source": "95 % interval of dqforge identify"}
