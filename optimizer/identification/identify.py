"""From the runs of a bench to one list of parameters: each run is analysed by its kind, what
several runs hold is combined, and what none holds is taken from what is known and said to be so.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.back_emf.capture import analyse as analyse_capture
from dqforge.machines.back_emf.columns import BemfCapture
from dqforge.machines.bench.bench_file import Bench, LoggedRun
from dqforge.machines.dq_machines.synchronous import torque_per_ampere
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.machines.records import dataclass
from dqforge.optimizer.identification.correlated_errors import Groups
from dqforge.optimizer.identification.flux_points import (
    FluxFit,
    FluxRows,
    analyse_points,
    points_fault,
)
from dqforge.optimizer.identification.inverter_curve import (
    InverterTable,
    analyse_table,
    table_fault,
)
from dqforge.optimizer.identification.locked_axes import (
    AXES,
    LockedAxes,
    analyse_locked,
    locked_fault,
)
from dqforge.optimizer.identification.log_checks import (
    Fitted,
    at_limit,
    log_findings,
    requested,
    rows_text,
    settled,
)
from dqforge.optimizer.identification.parameters import (
    Analysis,
    Parameter,
    mean_of_routes,
    unknown,
    with_prior,
)
from dqforge.optimizer.identification.shaft_tests import (
    Bursts,
    OffsetCurve,
    OffsetSweep,
    SpinDown,
    SpinUp,
    VoltageSteps,
    analyse_bursts,
    analyse_offsets,
    analyse_spin,
    analyse_spin_up,
    analyse_steps,
    bursts_fault,
    captured,
    offset_fault,
    spin_fault,
    spin_up_fault,
    steps_fault,
)
from dqforge.optimizer.identification.speed_sweep import Sweep, analyse_sweep, sweep_fault
from dqforge.optimizer.identification.voltage_terms import (
    HALF_95,
    SteadyRows,
    analyse_rows,
    rows_fault,
)

# What a design needs, and what is taken from what is known where no run holds it.
DESIGN_PARAMETERS = (
    ("resistance", "phase resistance", "Ohm"),
    ("inductance_d", "d-axis inductance", "H"),
    ("inductance_q", "q-axis inductance", "H"),
    ("magnet_flux", "magnet flux linkage", "Wb"),
    ("inertia", "moment of inertia", "kg m^2"),
    ("friction", "viscous friction", "N m s/rad"),
)


@dataclass(frozen=True, slots=True)
class Identification:
    """What the runs of a bench say.

    ``parameters`` are those of all analyses, each once; ``contradictions`` sentences on what cannot
    be, for which nothing may be taken into a design; ``flux`` is the flux map of ``flux-points``.
    """

    bench: Bench
    analyses: tuple[Analysis, ...]
    parameters: tuple[Parameter, ...]
    remarks: tuple[str, ...]
    contradictions: tuple[str, ...]
    flux: FluxFit | None = None

    def of(self, key: str) -> Parameter | None:
        """A parameter by its key."""
        return next((one for one in self.parameters if one.key == key), None)


def identify(bench: Bench) -> Identification:
    """Parameters of a machine from its runs.

    Raises:
        NoSolutionError: Runs say nothing of what they were made for; the message begins with the
            place of the first, the others are beside it.
    """
    faults: list[NoSolutionError] = []
    analyses: list[Analysis] = []
    flux: FluxFit | None = None
    below = []
    for run in bench.runs:
        try:
            below.append(_prepared(bench, run))
        except NoSolutionError as fault:
            faults.append(fault)
    bench = replace(bench, runs=tuple(below))
    groups = _together(bench.runs)
    for runs in groups:
        try:
            analysis, found = _analysed(bench, runs, analyses)
        except NoSolutionError as fault:
            faults.append(fault)
        else:
            analyses.append(analysis)
            flux = found or flux
    if faults:
        first, *others = faults
        first.others = tuple(others)
        raise first
    combined, remarks = _combined(analyses)
    combined = _without_each(bench, groups, analyses, combined, remarks)
    contradictions = [text for analysis in analyses for text in analysis.contradictions]
    parameters = [_with_known(bench, one, bool(contradictions), remarks) for one in combined]
    parameters += _only_known(bench, {one.key for one in combined})
    told = [text for run in bench.runs for text in run.remarks]
    told += [text for analysis in analyses for text in analysis.remarks]
    return Identification(
        bench,
        tuple(analyses),
        tuple(parameters),
        (*told, *remarks),
        tuple(contradictions),
        flux,
    )


def _analysed(
    bench: Bench, runs: Sequence[LoggedRun], before: Sequence[Analysis]
) -> tuple[Analysis, FluxFit | None]:
    """What runs of one kind hold, some of them by what the analyses before hold; and their flux
    map.

    Raises:
        NoSolutionError: They say nothing.
    """
    try:
        # What divides by nothing, or has no inverse, is a matter of the rows.
        with np.errstate(divide="raise", invalid="raise", over="raise"):
            if runs[0].kind == "flux-points":
                flux = _flux(bench, runs)
                flux = replace(flux, analysis=_believed(flux.analysis))
                return flux.analysis, flux
            if runs[0].kind in _AFTER:
                held = {one.key: one for one in _combined(before)[0] if one.status == "identified"}
                return _believed(_AFTER[runs[0].kind](bench, runs, held)), None
            return _believed(_ANALYSES[runs[0].kind](bench, runs)), None
    except (ArithmeticError, np.linalg.LinAlgError):
        raise refused(runs[0], _UNDETERMINED) from None


# So many runs hold a parameter jointly where each can be left out, and a move of so many standard
# deviations is that of a run that does not belong to the others.
_LEAST_JOINT, _FAR = 3, 3.0


def _without_each(
    bench: Bench,
    groups: Sequence[Sequence[LoggedRun]],
    analyses: Sequence[Analysis],
    combined: Sequence[Parameter],
    remarks: list[str],
) -> list[Parameter]:
    """Parameters with the run without which each moves most; remarks on those that move far."""
    moved: dict[str, tuple[str, float]] = {}
    joint = [
        one for one in combined if one.status == "identified" and len(one.runs) >= _LEAST_JOINT
    ]
    names = {name for one in joint for name in one.runs}
    for place, runs in enumerate(groups):
        for run in runs:
            if run.name not in names:
                continue
            others = [one for one in runs if one is not run]
            try:
                less = [_analysed(bench, others, analyses[:place])[0]] if others else []
            except NoSolutionError:
                continue
            left = {
                one.key: one
                for one in _combined([*analyses[:place], *less, *analyses[place + 1 :]])[0]
            }
            for one in joint:
                other = left.get(one.key)
                if run.name in one.runs and other is not None and other.sigma > 0.0:
                    move = (other.value - one.value) / other.sigma
                    if abs(move) > abs(moved.get(one.key, ("", 0.0))[1]):
                        moved[one.key] = (run.name, move)
    for one in joint:
        name, move = moved.get(one.key, ("", 0.0))
        if abs(move) > _FAR:
            remarks.append(
                f"{name}: without this run {one.label} moves by {move:+.1f} standard deviations; "
                "it does not belong to the others"
            )
    return [replace(one, moved=moved.get(one.key)) for one in combined]


def _believed(analysis: Analysis) -> Analysis:
    """An analysis; where routes contradict each other it identifies nothing."""
    if not analysis.contradictions:
        return analysis
    parameters = tuple(
        replace(one, status="not identified", why="two routes contradict each other")
        if one.status == "identified"
        else one
        for one in analysis.parameters
    )
    return replace(analysis, parameters=parameters)


_UNDETERMINED = (
    "its rows do not determine what a run of this kind holds: columns that stand still, or are in "
    "step with each other; check them"
)

# Kinds whose runs are fitted together: the parameters are the same, the series are parted.
_JOINT = ("constant-speed", "flux-points", "offset-sweep", "voltage-speed")


def _together(runs: Sequence[LoggedRun]) -> list[list[LoggedRun]]:
    """Runs that are analysed together, in the order of the bench file."""
    found: dict[tuple[object, ...], list[LoggedRun]] = {}
    accelerated = any(run.kind == "spin-up" for run in runs)
    for run in runs:
        joint = run.kind in _JOINT
        columns = tuple(sorted(run.parts[0].columns)) if run.kind == "constant-speed" else ()
        voltage = None if run.kind == "flux-points" else run.voltage
        key: tuple[object, ...] = (run.kind, run.index)
        if joint:
            key = (run.kind, columns, voltage)
        if run.kind in _SHAFT and accelerated:
            key = (_SHAFT,)
        found.setdefault(key, []).append(run)
    order = list(_AFTER)
    return sorted(
        found.values(),
        key=lambda group: 1 + order.index(group[0].kind) if group[0].kind in order else 0,
    )


_SHAFT = ("spin-up", "spin-down")


def refused(run: LoggedRun, why: str) -> NoSolutionError:
    """A run that says nothing of what it was made for."""
    return NoSolutionError(f"{run.place}: {why}")


# What the runs before hold, by key.
Held = Mapping[str, Parameter]

# Each kind: columns of the runs into arrays of its analysis.


def _known_values(bench: Bench, runs: Sequence[LoggedRun]) -> dict[str, tuple[float, str]]:
    """Other values by key, in SI units, and where they come from: the bench file before the log."""
    found: dict[str, tuple[float, str]] = {}
    for run in runs:
        for part in run.parts:
            for key, (value, place) in part.said.items():
                origin = f"{place} of {part.file}"
                if key == "kv":  # rpm per volt of the line-to-line peak
                    flux = 30.0 / (math.pi * value * math.sqrt(3.0) * bench.pole_pairs)
                    found.setdefault("magnet_flux", (flux, origin))
                else:
                    found.setdefault(key, (value, origin))
    for key, value in bench.known.items():
        found[key] = (value, f"machine.{bench.origins[key]}")
    return found


def _sweep(bench: Bench, runs: Sequence[LoggedRun]) -> Analysis:
    (run,) = runs
    u_q = run.column("u_q_less_drop")
    sweep = Sweep(
        run.name,
        run.need("i_d"),
        bench.pole_pairs * run.need("speed"),
        run.need("u_q") if u_q is None else u_q,
    )
    why = sweep_fault(sweep)
    if why:
        raise refused(run, why)
    return analyse_sweep(sweep, _known_values(bench, runs).get("magnet_flux"))


def _series(runs: Sequence[LoggedRun]) -> Groups:
    """Place of each row's run, shape (N,)."""
    return np.concatenate(
        [np.full(run.parts[0].rows.size, place, dtype=np.intp) for place, run in enumerate(runs)]
    )


def _joined(runs: Sequence[LoggedRun], quantity: str) -> FloatArray | None:
    """A quantity over the rows of all runs; None where not all have it."""
    parts = [run.column(quantity) for run in runs]
    whole = [part for part in parts if part is not None]
    return np.concatenate(whole) if len(whole) == len(runs) else None


def _flux(bench: Bench, runs: Sequence[LoggedRun]) -> FluxFit:
    i_d, i_q, u_d, u_q, speed = (
        np.concatenate([run.need(quantity) for run in runs])
        for quantity in ("i_d", "i_q", "u_d", "u_q", "speed")
    )
    rows = FluxRows(
        tuple(run.name for run in runs),
        _series(runs),
        i_d + 1j * i_q,
        u_d + 1j * u_q,
        bench.pole_pairs * speed,
        _joined(runs, "temperature"),
        any(run.voltage == "reference" for run in runs),
    )
    why = points_fault(rows)
    if why:
        raise refused(runs[0], why)
    found = analyse_points(rows)
    return replace(found, analysis=_examined(bench, runs, found.analysis))


def _prepared(bench: Bench, run: LoggedRun) -> LoggedRun:
    """A run of currents, voltages and speed without the rows whose voltage stood at its limit, and
    held points as means of their steady windows; what was done is in its remarks.

    Raises:
        NoSolutionError: All rows stood at the limit.
    """
    if run.kind not in ("constant-speed", "flux-points"):
        return run
    run = replace(run, remarks=(*run.remarks, *requested(run)))
    clipped, why = at_limit(run, bench.v_dc)
    if why and clipped.all():
        raise refused(run, f"{why} in all rows: clipped; run below the voltage limit")
    if why:
        told = f"{run.name}: {why} in {rows_text(run, clipped)}: clipped, left out"
        run = run.some(~clipped, told)
    return settled(run) if run.kind == "constant-speed" else run


def _examined(bench: Bench, runs: Sequence[LoggedRun], analysis: Analysis) -> Analysis:
    """An analysis of currents, voltages and speed with what the logs themselves show."""
    values = {one.key: one.value for one in analysis.parameters}
    resistance = values.get("resistance", math.nan)
    if not math.isfinite(resistance):
        resistance = bench.known.get("resistance", math.nan)
    fitted = Fitted(resistance, values.get("inverter_voltage", math.nan))
    found = [log_findings(run, bench.pole_pairs, fitted) for run in runs]
    return replace(
        analysis,
        remarks=(*analysis.remarks, *(text for one in found for text in one.remarks)),
        contradictions=(
            *analysis.contradictions,
            *(text for one in found for text in one.contradictions),
        ),
    )


def _middle(bench: Bench) -> float | None:
    """Mean temperature of all such runs in degC, for which their resistances are given; None where
    none was logged.
    """
    logged = [run.column("temperature") for run in bench.runs if run.kind == "constant-speed"]
    found = [values for values in logged if values is not None]
    return float(np.mean(np.concatenate(found))) if found else None


def _steps(bench: Bench, runs: Sequence[LoggedRun]) -> dict[str, float] | None:
    """Steps of columns that are means, of the coarsest run; None where none has means."""
    found: dict[str, float] = {}
    for run in runs:
        for name, step in (run.steps or {}).items():
            key, scale = ("omega_e", bench.pole_pairs) if name == "speed" else (name, 1)
            found[key] = max(found.get(key, 0.0), scale * step)
    return found if any(run.steps is not None for run in runs) else None


def _rows(bench: Bench, runs: Sequence[LoggedRun], held: Held) -> Analysis:
    speed, i_q, u_q = (
        np.concatenate([run.need(quantity) for run in runs]) for quantity in ("speed", "i_q", "u_q")
    )
    rows = SteadyRows(
        tuple(run.name for run in runs),
        _series(runs),
        bench.pole_pairs * speed,
        i_q,
        u_q,
        _joined(runs, "i_d"),
        _joined(runs, "u_d"),
        _joined(runs, "temperature"),
        _steps(bench, runs),
        _middle(bench),
    )
    why = rows_fault(rows)
    if why:
        raise refused(runs[0], why)
    reference = runs[0].voltage == "reference"
    known, own = _known_values(bench, runs), held.get("inductance_d")
    inductance: tuple[float, float, str] | None
    if own is None and "inductance_d" in known:
        value = known["inductance_d"][0]
        sigma = bench.widths.get("inductance_d", _DATA_SHEET * value) / HALF_95
        inductance = value, sigma, known["inductance_d"][1]
    else:
        inductance = None if own is None else (own.value, own.sigma, ", ".join(own.runs))
    found = analyse_rows(rows, known, reference=reference, inductance_d=inductance)
    return _examined(bench, runs, found)


# Half of the 95 % interval of a data sheet's inductance.
_DATA_SHEET = 0.2


def _offsets(bench: Bench, runs: Sequence[LoggedRun]) -> Analysis:
    sweeps = []
    for run in runs:
        curves = []
        for part in run.parts:
            offset = part.columns.get("encoder_offset")
            curves += [
                OffsetCurve(quantity, offset, values)
                for quantity, values in part.columns.items()
                if quantity in ("u_d", "u_q", "psi_d", "psi_q") and offset is not None
            ]
        speed = run.constants.get("speed")
        if speed is None:
            found = run.column("speed")
            speed = math.nan if found is None else float(np.mean(found))
        sweep = OffsetSweep(run.name, speed, tuple(curves))
        why = offset_fault(sweep) if curves else "no curve of u_d, u_q, psi_d or psi_q"
        if why:
            raise refused(run, why)
        sweeps.append(sweep)
    return analyse_offsets(sweeps, bench.pole_pairs, _known_values(bench, runs).get("magnet_flux"))


def _voltage_steps(_bench: Bench, runs: Sequence[LoggedRun]) -> Analysis:
    steps = []
    for run in runs:
        columns = (run.need(name) for name in ("time", "voltage", "speed"))
        steps.append(VoltageSteps(run.name, *columns))
        why = steps_fault(steps[-1])
        if why:
            raise refused(run, why)
    return analyse_steps(steps)


def _bursts(bench: Bench, runs: Sequence[LoggedRun]) -> Analysis:
    (run,) = runs
    current = run.column("current")
    bursts = Bursts(
        run.name,
        run.need("time"),
        run.need("i_q") if current is None else current,
        run.need("torque"),
    )
    why = bursts_fault(bursts)
    if why:
        raise refused(run, why)
    known = _known_values(bench, runs).get("magnet_flux")
    return analyse_bursts(bursts, bench.pole_pairs, known)


def _spin(bench: Bench, runs: Sequence[LoggedRun]) -> Analysis:
    (run,) = runs
    spin = SpinDown(run.name, run.need("time"), run.need("speed"))
    why = spin_fault(spin)
    if why:
        raise refused(run, why)
    if "inertia" not in bench.known:
        raise refused(
            run,
            "no coasting shows the inertia; write inertia under machine, or add a run of kind "
            "spin-up",
        )
    return analyse_spin(spin, bench.known["inertia"])


def _shaft(bench: Bench, runs: Sequence[LoggedRun], held: Held) -> Analysis:
    """Accelerations with coasting, or coasting alone with a known inertia."""
    up = [run for run in runs if run.kind == "spin-up"]
    if not up:
        return _spin(bench, runs)
    own, spins = held.get("magnet_flux"), []
    flux = bench.known.get("magnet_flux") if own is None else own.value
    for run in runs:
        time, speed = run.need("time"), run.need("speed")
        coasting = run.kind == "spin-down"
        spins.append(
            SpinUp(run.name, time, np.zeros_like(time) if coasting else run.need("i_q"), speed)
        )
        why = spin_fault(SpinDown(run.name, time, speed)) if coasting else spin_up_fault(spins[-1])
        if why:
            raise refused(run, why)
    if flux is None:
        raise refused(
            up[0],
            "its torque needs the magnet flux linkage; write magnet_flux, or a constant of the "
            "data sheet, under machine, or add a run that holds it",
        )
    constant = torque_per_ampere(bench.pole_pairs, flux)
    return analyse_spin_up(spins, constant, 0.0 if own is None else own.sigma / own.value)


def _locked(bench: Bench, runs: Sequence[LoggedRun]) -> Analysis:
    (run,) = runs
    columns = {name: run.column(name) for name in ("i_d", "i_q", "u_d", "u_q")}
    pairs = {
        axis: (current, voltage)
        for axis in AXES
        if (current := columns[f"i_{axis}"]) is not None
        and (voltage := columns[f"u_{axis}"]) is not None
    }
    temperature = run.column("temperature")
    rows = LockedAxes(
        run.name,
        run.need("time"),
        {axis: pair[0] for axis, pair in pairs.items()},
        {axis: pair[1] for axis, pair in pairs.items()},
        None if temperature is None else float(np.mean(temperature)),
    )
    why = locked_fault(rows)
    if why:
        raise refused(run, why)
    return analyse_locked(rows, _known_values(bench, runs), reference=run.voltage == "reference")


def _back_emf(bench: Bench, runs: Sequence[LoggedRun]) -> Analysis:
    (run,) = runs
    part = run.parts[0]
    capture = BemfCapture(
        part.file, run.need("time"), None, run.need("line_voltage")[None, :], part.rows,
        "line-to-line",
    )  # fmt: skip
    speed = run.column("speed")
    try:
        found = analyse_capture(
            capture,
            pole_pairs=bench.pole_pairs,
            speed=None if speed is None else float(np.mean(speed)),
        )
    except InputError as error:
        raise refused(run, error.message) from None
    return captured(run.name, found, _known_values(bench, runs).get("magnet_flux"))


def _inverter(_bench: Bench, runs: Sequence[LoggedRun]) -> Analysis:
    (run,) = runs
    table = InverterTable(run.name, run.need("current"), run.need("voltage"))
    why = table_fault(table)
    if why:
        raise refused(run, why)
    return analyse_table(table)


_ANALYSES: dict[str, Callable[[Bench, Sequence[LoggedRun]], Analysis]] = {
    "speed-sweep": _sweep,
    "offset-sweep": _offsets,
    "voltage-speed": _voltage_steps,
    "locked-torque": _bursts,
    "locked-voltage": _locked,
    "back-emf": _back_emf,
    "inverter-table": _inverter,
}

# Kinds that need what others hold, in their order: psi_d of a d current, the torque of a current.
_AFTER: dict[str, Callable[[Bench, Sequence[LoggedRun], Held], Analysis]] = {
    "constant-speed": _rows,
    "spin-up": _shaft,
    "spin-down": _shaft,
}


# One list of parameters.


# Intervals that become wider by less are those of runs that agree.
_WIDENED = 1.05


def _combined(analyses: Sequence[Analysis]) -> tuple[list[Parameter], list[str]]:
    """Parameters by key in the order of the analyses; those that several hold are averaged."""
    by_key: dict[str, list[Parameter]] = {}
    for analysis in analyses:
        for parameter in analysis.parameters:
            by_key.setdefault(parameter.key, []).append(parameter)
    found, remarks = [], []
    for routes in by_key.values():
        held = [one for one in routes if one.status == "identified"]
        if len(held) < 2:
            found.append(held[0] if held else routes[0])
            continue
        mean, scale = mean_of_routes(held)
        found.append(mean)
        if scale > _WIDENED:
            values = ", ".join(f"{one.value:.5g}" for one in held)
            remarks.append(
                f"{mean.label}: the runs differ by more than their intervals ({values} "
                f"{mean.unit}); the interval is widened by {scale:.1f}"
            )
    return found, remarks


def _with_known(
    bench: Bench, parameter: Parameter, contradicted: bool, remarks: list[str]
) -> Parameter:
    """A parameter that no run holds becomes what is known of it, and says so; what is known with a
    width is averaged with what the runs say.
    """
    known, half = bench.known.get(parameter.key), bench.widths.get(parameter.key)
    if contradicted or known is None:
        return parameter
    if half is not None:
        origin = f"machine.{bench.origins[parameter.key]}"
        mean, scale = with_prior(parameter, known, half, origin)
        if scale > HALF_95:  # 95 of 100 pairs of values are closer
            remarks.append(
                f"{mean.label}: {parameter.value:.5g} {mean.unit} of the runs and {known:.5g} "
                f"{mean.unit} of {origin} differ by more than their intervals; that of the mean is "
                f"widened by {scale:.1f}"
            )
        return mean
    if parameter.status == "identified":
        return parameter
    return _from_known(bench, (parameter.key, parameter.label, parameter.unit), parameter.why)


def _from_known(bench: Bench, named: tuple[str, str, str], why: str) -> Parameter:
    known, origin = bench.known[named[0]], f"machine.{bench.origins[named[0]]}"
    half = bench.widths.get(named[0])
    if half is not None:
        return with_prior(unknown(named, why), known, half, origin)[0]
    nan = float("nan")
    return Parameter(*named, known, nan, nan, nan, "prior-dominated", f"from {origin}: {why}")


def _only_known(bench: Bench, there: set[str]) -> list[Parameter]:
    return [
        _from_known(bench, named, "no run of this kind")
        for named in DESIGN_PARAMETERS
        if named[0] in bench.known and named[0] not in there
    ]
