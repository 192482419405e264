"""Flux maps from points at constant speed: what is not the machine is found and removed, and the
points are kept.

At a point jw psi(i_m) = u - R(T) i - V0 s(i) - offset in the frame of the rotor, which is turned by
delta from that of the encoder, with i_m = i - jw psi/R_fe past the iron. psi is the gradient of a
co-energy W(i), even in i_q, as cubic B-splines; R, V0, delta, 1/R_fe and offsets are fitted with it
by Gauss-Newton. The map that is written is that of the points without those errors: a strictly
reciprocal spline is not within the noise of measured machines.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.interpolate import BSpline

from dqforge.machines.arrays import ComplexArray, FloatArray
from dqforge.machines.records import dataclass
from dqforge.optimizer.identification.correlated_errors import Groups, correlation_time, long_run
from dqforge.optimizer.identification.parameters import (
    Analysis,
    Parameter,
    RunResiduals,
    judged,
    unknown,
    with_partners,
)
from dqforge.optimizer.identification.voltage_terms import COPPER

# Intervals of the spline over the d and q currents; those of the measured Baldor map, on which 12
# x 16 leave 1.1 mV s and a leave-one-out error of 1.3.
_MOST_INTERVALS = (12, 16)
_POINTS_PER_INTERVAL = 1.5
_DEGREE = 3
# Weight of the penalty on third differences: it only holds coefficients that no point reaches.
_FIRM = 1e-7
_ROUNDS = 12
_SETTLED = 1e-7
# Points within this share of the largest current are the same point.
_SAME = 0.01
# Share of the points that need a partner at -i_q before the angle can be told.
_MIRRORED = 0.5
_KEYS = {
    "resistance": ("phase resistance", "Ohm"),
    "inverter_voltage": ("voltage error of the inverter along the current", "V"),
    "encoder_angle": ("error of the encoder's angle", "rad"),
    "iron_conductance": ("conductance of the iron, 1/R_fe", "S"),
    "offset_d": ("offset of u_d", "V"),
    "offset_q": ("offset of u_q", "V"),
}
_SMOOTH = 0.02


@dataclass(frozen=True, slots=True)
class FluxRows:
    """Points of runs: currents (A) and voltages (V) as d + jq in the frame of the encoder,
    electrical speed (rad/s) with its sign, temperature of the winding (degC) or None; each of shape
    (N,). ``series`` is the place of each point's run in ``runs``, ``reference`` whether the
    voltages are what the controller requested and hold the error of the inverter.
    """

    runs: tuple[str, ...]
    series: Groups
    current: ComplexArray
    voltage: ComplexArray
    omega_e: FloatArray
    temperature: FloatArray | None = None
    reference: bool = True

    @property
    def warmth(self) -> FloatArray:
        """Resistance over that at 20 degC, or over that of the points where no temperature was
        logged, shape (N,).
        """
        if self.temperature is None:
            return np.ones(self.omega_e.size)
        return np.asarray(1.0 + COPPER * (self.temperature - 20.0))


@dataclass(frozen=True, slots=True)
class FluxTable:
    """A map of points, each of shape (M,): currents (A), flux linkages and their standard
    deviations (V s), and how many rows each is made from. ``shared`` is what one standard deviation
    of each error that all points share makes of psi_d and psi_q, V s, shape (S, 2, M).
    """

    i_d: FloatArray
    i_q: FloatArray
    psi_d: FloatArray
    psi_q: FloatArray
    sigma_d: FloatArray
    sigma_q: FloatArray
    count: NDArray[np.intp]
    shared: FloatArray


@dataclass(frozen=True, slots=True)
class Curl:
    """R.m.s. difference of d psi_d/d i_q and d psi_q/d i_d over the cells of a map, and r.m.s. mean
    of both, the cross inductance; H.
    """

    rms: float
    cross: float


@dataclass(frozen=True, slots=True)
class FluxFit:
    """Analysis of the points, the map of the points, and that of the spline at the same currents,
    complex, shape (M,). ``one_out`` is the r.m.s. error of the spline at a point it was not fitted
    to, V s; ``curl`` that of the map against reciprocity, None where its points fill no grid.
    """

    analysis: Analysis
    table: FluxTable
    spline: ComplexArray
    one_out: float
    curl: Curl | None


class _Energy:
    """Co-energy over both currents: columns of its gradient and second derivatives."""

    def __init__(self, current: ComplexArray) -> None:
        self.low = float(current.real.min()), -float(np.abs(current.imag).max())
        self.high = float(current.real.max()), float(np.abs(current.imag).max())
        margin = [0.02 * (high - low) + 1e-9 for low, high in zip(self.low, self.high, strict=True)]
        levels = (
            np.unique(np.round(current.real, 3)).size,
            np.unique(np.round(current.imag, 3)).size,
        )
        self.knots = []
        for axis, most in enumerate(_MOST_INTERVALS):
            count = max(2, min(most, int(levels[axis] / _POINTS_PER_INTERVAL)))
            count += axis * (count % 2)
            inner = np.linspace(
                self.low[axis] - margin[axis], self.high[axis] + margin[axis], count + 1
            )
            step = inner[1] - inner[0]
            before = inner[0] - step * np.arange(_DEGREE, 0, -1)
            after = inner[-1] + step * np.arange(1, _DEGREE + 1)
            self.knots.append(np.concatenate([before, inner, after]))
        self.counts = tuple(knots.size - _DEGREE - 1 for knots in self.knots)
        # Coefficients at -i_q are those at i_q.
        half = (self.counts[1] + 1) // 2
        rows = np.arange(self.counts[1])
        self.fold = sparse.csr_matrix(
            (np.ones(rows.size), (rows, np.minimum(rows, rows[::-1]))), (rows.size, half)
        )
        self.size = self.counts[0] * half

    def _basis(self, axis: int, values: FloatArray, order: int) -> sparse.csr_matrix:
        knots = self.knots[axis]
        low, high = knots[_DEGREE], knots[-_DEGREE - 1]
        inside = np.clip(values, low, high)
        if order == 0:
            return sparse.csr_matrix(BSpline.design_matrix(inside, knots, _DEGREE))
        # The derivative of B-splines are differences of those of one degree less.
        lower = BSpline.design_matrix(inside, knots[order:-order], _DEGREE - order)
        step = knots[1] - knots[0]
        differences = np.diff(np.eye(self.counts[axis]), order, axis=0) / step**order
        return sparse.csr_matrix(lower @ sparse.csr_matrix(differences))

    def columns(self, current: ComplexArray, order_d: int, order_q: int) -> sparse.csr_matrix:
        """Columns of a derivative of the co-energy at currents, shape (N, size)."""
        over_d = self._basis(0, current.real, order_d)
        over_q = self._basis(1, current.imag, order_q) @ self.fold
        return sparse.csr_matrix(_row_products(over_d, over_q))

    def flux(self, current: ComplexArray, coefficients: FloatArray) -> ComplexArray:
        """Flux linkages, complex, shape (N,)."""
        return np.asarray(
            self.columns(current, 1, 0) @ coefficients
            + 1j * (self.columns(current, 0, 1) @ coefficients)
        )

    def slopes(self, current: ComplexArray, coefficients: FloatArray) -> tuple[FloatArray, ...]:
        """Differential inductances dd, dq and qq, H, each of shape (N,)."""
        orders = ((2, 0), (1, 1), (0, 2))
        return tuple(self.columns(current, *order) @ coefficients for order in orders)

    def firmness(self) -> sparse.csr_matrix:
        """Third differences of the coefficients along both axes, and their mean, which no flux
        linkage depends on.
        """
        half = self.fold.shape[1]
        first = np.diff(np.eye(self.counts[0]), 3, axis=0)
        second = np.diff(self.fold.toarray(), 3, axis=0)
        mean = np.full((1, self.size), 1.0 / self.size)
        return sparse.csr_matrix(
            sparse.vstack(
                [
                    sparse.kron(first, sparse.eye(half)),
                    sparse.kron(sparse.eye(self.counts[0]), second),
                    sparse.csr_matrix(mean),
                ]
            )
        )


def _row_products(first: sparse.csr_matrix, second: sparse.csr_matrix) -> sparse.csr_matrix:
    """Products of each row of one matrix with the same row of another, shape (N, A B)."""
    ones_first = sparse.csr_matrix(np.ones((1, second.shape[1])))
    ones_second = sparse.csr_matrix(np.ones((1, first.shape[1])))
    spread = sparse.kron(first, ones_first, "csr")
    return sparse.csr_matrix(spread.multiply(sparse.kron(ones_second, second, "csr")))


@dataclass(slots=True)
class _State:
    """Unknowns of the fit: coefficients of the co-energy, and the errors by key."""

    energy: FloatArray
    errors: dict[str, float]


class _Model:
    """Points with what is fitted to them."""

    def __init__(self, rows: FluxRows) -> None:
        self.rows = rows
        self.energy = _Energy(rows.current)
        self.keys = tuple(self._held())
        whole = np.abs(rows.current)
        self.small = _SMOOTH * float(whole.max())

    def _held(self) -> list[str]:
        """Errors that the points can tell from the machine."""
        rows = self.rows
        keys = ["resistance", "iron_conductance", "offset_d"]
        if rows.reference:
            keys.append("inverter_voltage")
        if mirrored_share(rows.current) >= _MIRRORED:
            keys.append("encoder_angle")
        if (rows.omega_e > 0.0).any() and (rows.omega_e < 0.0).any():
            keys.append("offset_q")
        return keys

    def sign(self, current: ComplexArray) -> ComplexArray:
        """Direction of the current, smoothed about zero."""
        return np.asarray(current / np.hypot(np.abs(current), self.small))

    def turned(self, state: _State) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
        """Current and voltage in the frame of the rotor, and the current past the iron."""
        errors, rows = state.errors, self.rows
        turn = np.exp(1j * errors.get("encoder_angle", 0.0))
        current = rows.current * turn
        offset = errors.get("offset_d", 0.0) + 1j * errors.get("offset_q", 0.0)
        voltage = (rows.voltage - offset) * turn
        drop = errors["resistance"] * rows.warmth * current
        emf = voltage - drop - errors["inverter_voltage"] * self.sign(current)
        return current, voltage, current - errors["iron_conductance"] * emf

    def flux(self, state: _State) -> ComplexArray:
        """Flux linkages of the points without the errors, V s, shape (N,)."""
        current, voltage, _ = self.turned(state)
        drop = state.errors["resistance"] * self.rows.warmth * current
        emf = voltage - drop - state.errors["inverter_voltage"] * self.sign(current)
        return np.asarray(emf / (1j * self.rows.omega_e))

    def error_columns(self, state: _State) -> ComplexArray:
        """What the residual flux linkage changes by with each error, complex, shape (N, K)."""
        rows = self.rows
        current, _, through = self.turned(state)
        turn = np.exp(1j * state.errors.get("encoder_angle", 0.0))
        conductance = state.errors["iron_conductance"]
        sign = self.sign(current)
        emf = 1j * rows.omega_e * self.flux(state)
        by_emf = {
            "resistance": -rows.warmth * current,
            "inverter_voltage": -sign,
            "encoder_angle": 1j * emf,
            "offset_d": -turn * np.ones_like(current),
            "offset_q": -1j * turn * np.ones_like(current),
            "iron_conductance": np.zeros_like(current),
        }
        dd, dq, qq = self.energy.slopes(through, state.energy)
        columns = []
        for key in self.keys:
            change = by_emf[key]
            moved = -conductance * change
            if key == "encoder_angle":
                moved = moved + 1j * current
            if key == "iron_conductance":
                moved = moved - emf
            of_machine = dd * moved.real + dq * moved.imag
            of_machine = of_machine + 1j * (dq * moved.real + qq * moved.imag)
            columns.append(change / (1j * rows.omega_e) - of_machine)
        return np.column_stack(columns)

    def fitted(self) -> tuple[_State, FloatArray, FloatArray, sparse.csr_matrix]:
        """The state, residuals (V s, d rows before q rows), columns of the errors, columns of the
        co-energy.
        """
        state = _State(np.zeros(self.energy.size), dict.fromkeys(_KEYS, 0.0))
        firm = self.energy.firmness()
        penalty = (firm.T @ firm).toarray()
        errors = np.zeros((2 * self.rows.omega_e.size, 0))
        for round_ in range(_ROUNDS):
            _, _, through = self.turned(state)
            columns = _stacked(self.energy, through)
            flux = _real(self.flux(state))
            errors = _real(self.error_columns(state))
            if round_ == 0:  # nothing is known of the machine yet: only what is linear
                errors = errors * np.array([key != "iron_conductance" for key in self.keys])
                errors = errors * np.array([key != "encoder_angle" for key in self.keys])
            # flux + errors step = columns energy
            step = self._step(columns, errors, flux, penalty)
            state.energy = step[: self.energy.size]
            change = step[self.energy.size :]
            for key, value in zip(self.keys, change, strict=True):
                state.errors[key] += float(value)
            scale = np.linalg.norm(errors * change, axis=0).max() / np.linalg.norm(flux)
            if round_ > 1 and scale < _SETTLED:
                break
        _, _, through = self.turned(state)
        columns = _stacked(self.energy, through)
        residuals = _real(self.flux(state)) - columns @ state.energy
        return state, residuals, _real(self.error_columns(state)), columns

    def _step(
        self,
        columns: sparse.csr_matrix,
        errors: FloatArray,
        flux: FloatArray,
        penalty: FloatArray,
    ) -> FloatArray:
        """Coefficients of the co-energy and steps of the errors, by bordered normal equations."""
        size = np.linalg.norm(errors, axis=0)
        size = np.where(size > 0.0, size, 1.0)
        border = -errors / size
        top = (columns.T @ columns).toarray()
        level = float(np.trace(top)) / top.shape[0]
        top += level * (penalty / max(float(np.trace(penalty)) / top.shape[0], 1e-300)) * _FIRM
        side = columns.T @ border
        corner = border.T @ border + 1e-14 * np.eye(border.shape[1])
        whole = np.block([[top, side], [side.T, corner]])
        right = np.concatenate([columns.T @ flux, border.T @ flux])
        found = np.linalg.solve(whole, right)
        found[columns.shape[1] :] /= size
        return np.asarray(found)


def _stacked(energy: _Energy, current: ComplexArray) -> sparse.csr_matrix:
    return sparse.csr_matrix(
        sparse.vstack([energy.columns(current, 1, 0), energy.columns(current, 0, 1)])
    )


def _real(values: ComplexArray) -> FloatArray:
    return np.concatenate([values.real, values.imag])


def _complex(values: FloatArray) -> ComplexArray:
    half = values.size // 2
    return np.asarray(values[:half] + 1j * values[half:])


def mirrored_share(current: ComplexArray) -> float:
    """Share of the points with a q current that have a partner at the same i_d and -i_q."""
    width = _SAME * float(np.abs(current).max())
    with_q = current[np.abs(current.imag) > width]
    if with_q.size == 0:
        return 0.0
    keys = {(round(one.real / width / 2), round(one.imag / width / 2)) for one in with_q}
    there = [
        any(
            (round(one.real / width / 2) + a, round(-one.imag / width / 2) + b) in keys
            for a in (-1, 0, 1)
            for b in (-1, 0, 1)
        )
        for one in with_q
    ]
    return float(np.mean(there))


# What the fit says: errors with intervals, the map of the points, what a strict co-energy costs.


def points_fault(rows: FluxRows) -> str:
    """Why points give no map, '' where they do."""
    if (rows.omega_e == 0.0).any():
        return "a point at standstill has no flux linkage in its voltage; leave it out"
    levels = [levels_apart(values).max() + 1 for values in (rows.current.real, rows.current.imag)]
    if min(levels) < _LEAST_LEVELS:
        return (
            f"{levels[0]} levels of i_d and {levels[1]} of i_q; a map needs {_LEAST_LEVELS} of each"
        )
    unknowns = _Energy(rows.current).size + len(_KEYS)
    if 2 * rows.omega_e.size < unknowns:
        return f"{rows.omega_e.size} points for {unknowns} unknowns; measure more"
    return ""


_LEAST_LEVELS = 4
_LEVEL_GAP = 0.004


def levels_apart(values: FloatArray) -> Groups:
    """Label of each value's level, ascending, where levels lie apart by 0.4 % of the range or more,
    shape (N,).
    """
    order = np.argsort(values, kind="stable")
    found = np.empty(values.size, dtype=np.intp)
    gaps = np.diff(values[order]) > _LEVEL_GAP * max(float(np.ptp(values)), 1e-12)
    found[order] = np.concatenate([[0], np.cumsum(gaps)])
    return found


def analyse_points(rows: FluxRows) -> FluxFit:
    """Errors of the bench and the flux map of points that `points_fault` has nothing against."""
    model = _Model(rows)
    state, residuals, errors, columns = model.fitted()
    design = np.hstack([columns.toarray(), -errors])
    normal = design.T @ design
    normal[np.diag_indices_from(normal)] += 1e-10 * np.trace(normal) / normal.shape[0]
    inverse = np.linalg.inv(normal)
    leverage = np.sum((design @ inverse) * design, axis=1)
    one_out = float(np.sqrt(np.mean((residuals / np.maximum(1.0 - leverage, 0.05)) ** 2)))
    covariance, freedom = _error_covariance(model, residuals, errors, columns)
    parameters = _parameters(model, state, covariance, freedom)
    table, spline = _table(model, state, covariance)
    curl = curl_of(table)
    analysis = _said(model, parameters, covariance, residuals, freedom, one_out, table, curl)
    return FluxFit(analysis, table, spline, one_out, curl)


def _error_covariance(
    model: _Model, residuals: FloatArray, errors: FloatArray, columns: sparse.csr_matrix
) -> tuple[FloatArray, float]:
    """Covariance of the errors as a sandwich in two parts, and effective degrees of freedom.

    What the spline cannot follow of the machine is the same in all rows of a point and mirrored at
    -i_q; nearly all of the errors' columns lies in what those rows differ by, which holds noise
    alone. Each part has its own scores, one of each point, correlated from point to point.
    """
    rows = model.rows
    top = (columns.T @ columns).toarray()
    top[np.diag_indices_from(top)] += 1e-9 * np.trace(top) / top.shape[0]
    own = errors - columns @ np.linalg.solve(top, columns.T @ errors)
    size = np.linalg.norm(own, axis=0)
    size = np.where(size > 0.0, size, 1.0)
    label = _points(rows.current)
    # In the order in which the points were run, those of a run together.
    _, first, at = np.unique(label, return_index=True, return_inverse=True)
    order = np.argsort(first)
    left = _folded(_complex(residuals), rows.current)
    each = [_folded(_complex(column), rows.current) for column in (own / size).T]
    count = np.bincount(at)
    mean_left, apart_left = _parted(left, at)
    within, between = [], []
    for column in each:
        mean, apart = _parted(column, at)
        within.append(np.bincount(at, (apart * apart_left.conj()).real)[order])
        between.append((count * mean * mean_left.conj()).real[order])
    series = rows.series[first][order]
    used = model.energy.size
    free_apart = max(2 * (label.size - count.size) - errors.shape[1], 1)
    share_apart = 2.0 * (label.size - count.size) / free_apart
    share_mean = 2.0 * count.size / max(2 * count.size - used, 1)
    one, scale = np.ones(series.size), np.ones(len(within))
    meat = share_apart * long_run(np.column_stack(within), one, scale, series)
    meat += share_mean * long_run(np.column_stack(between), one, scale, series)
    bread = np.linalg.inv((own / size).T @ (own / size))
    runs = np.concatenate([rows.series, rows.series + len(rows.runs)])
    free = max(residuals.size - used - errors.shape[1], 1)
    freedom = max(free / correlation_time(residuals, runs), 1.0)
    return bread @ meat @ bread / np.outer(size, size), freedom


def _points(current: ComplexArray) -> Groups:
    """Label of the point of the machine that each row is of, mirrored ones together, shape (N,)."""
    level_q = levels_apart(np.abs(current.imag))
    return np.asarray(levels_apart(current.real) * (level_q.max() + 1) + level_q)


def _folded(flux: ComplexArray, current: ComplexArray) -> ComplexArray:
    """Flux linkages at positive i_q: the q part at -i_q is that at i_q with another sign."""
    return np.asarray(np.where(current.imag < 0.0, flux.conj(), flux))


def _parted(values: ComplexArray, at: Groups) -> tuple[ComplexArray, ComplexArray]:
    """Means over the rows of each point, and what the rows differ from them by."""
    whole = np.bincount(at, values.real) + 1j * np.bincount(at, values.imag)
    means = np.asarray(whole / np.bincount(at), np.complex128)
    return means, np.asarray(values - means[at])


def _parameters(
    model: _Model, state: _State, covariance: FloatArray, freedom: float
) -> list[Parameter]:
    runs = model.rows.runs
    turned = "encoder_angle" not in model.keys
    reason = ""
    if turned:
        reason = (
            "points at +-i_q are missing: a turned machine is a machine again, and the angle of "
            "the encoder moves into the other errors and the map; measure both signs of i_q"
        )
    found = []
    for place, key in enumerate(model.keys):
        label, unit = _KEYS[key]
        if key == "resistance" and model.rows.temperature is not None:
            label += " at 20 degC"
        sigma = float(np.sqrt(covariance[place, place]))
        named = (key, label, unit)
        found.append(
            judged(
                named,
                state.errors[key],
                sigma,
                freedom,
                runs=runs,
                reason=reason or _unphysical(key, state.errors[key]),
                may_vanish=key not in ("resistance",),
            )
        )
    found = with_partners(found, covariance)
    why = {
        "encoder_angle": reason,
        "offset_q": "one sign of the speed: an offset of u_q and the magnets look the same",
    }
    found += [unknown((key, *_KEYS[key]), why[key]) for key in why if key not in model.keys]
    return found


def _unphysical(key: str, value: float) -> str:
    """Why a value is none, '' where it can be one."""
    return "below 0, which it cannot be" if key == "iron_conductance" and value < 0.0 else ""


def _table(model: _Model, state: _State, covariance: FloatArray) -> tuple[FluxTable, ComplexArray]:
    """Points without the errors, moved to the current they were set to, means over repeats and
    mirrored points.
    """
    rows = model.rows
    _, _, through = model.turned(state)
    moved = model.energy.flux(rows.current, state.energy) - model.energy.flux(through, state.energy)
    flux = model.flux(state) + moved
    folded = _folded(flux, rows.current)
    names, at = np.unique(_points(rows.current), return_inverse=True)
    count = np.bincount(at)
    means, apart = _parted(folded, at)
    by_error = (_folded(column, rows.current) for column in model.error_columns(state).T)
    slopes = np.column_stack([_parted(column, at)[0] for column in by_error])
    noise = _noise(apart, count[at])
    # Independent causes of the covariance of the errors, and what each makes of the means.
    values, vectors = np.linalg.eigh(covariance)
    shared = slopes @ (vectors * np.sqrt(np.maximum(values, 0.0)))
    sigma = [
        np.sqrt(size**2 / count + np.sum(part**2, axis=1))
        for size, part in zip(noise, (shared.real, shared.imag), strict=True)
    ]
    i_d = np.bincount(at, rows.current.real) / count
    i_q = np.bincount(at, np.abs(rows.current.imag)) / count
    both = np.concatenate([np.flatnonzero(i_q > 1e-9)[::-1], np.arange(names.size)])
    turn = np.concatenate([-np.ones(both.size - names.size), np.ones(names.size)])
    order = np.lexsort((turn * i_q[both], i_d[both]))
    both, turn = both[order], turn[order]
    psi_q = np.where(i_q < 1e-9, 0.0, means.imag)
    table = FluxTable(
        i_d[both],
        turn * i_q[both],
        means.real[both],
        turn * psi_q[both],
        sigma[0][both],
        sigma[1][both],
        count[both],
        np.stack([shared.real[both], turn[:, None] * shared.imag[both]]).transpose(2, 0, 1),
    )
    return table, model.energy.flux(table.i_d + 1j * table.i_q, state.energy)


def curl_of(table: FluxTable) -> Curl | None:
    """What a map errs against reciprocity, None where its points fill no grid."""
    row, column = levels_apart(table.i_d), levels_apart(table.i_q)
    shape = int(row.max()) + 1, int(column.max()) + 1
    if min(shape) < 2 or table.i_d.size != shape[0] * shape[1]:
        return None
    if np.unique(row * shape[1] + column).size != table.i_d.size:
        return None
    psi = np.empty((2, *shape))
    psi[:, row, column] = table.psi_d, table.psi_q
    i_d = np.bincount(row, table.i_d) / shape[1]
    i_q = np.bincount(column, table.i_q) / shape[0]
    over_q = np.diff(psi[0], axis=1) / np.diff(i_q)
    over_d = np.diff(psi[1], axis=0) / np.diff(i_d)[:, None]
    # Both in the middle of a cell.
    d_by_q = 0.5 * (over_q[1:] + over_q[:-1])
    q_by_d = 0.5 * (over_d[:, 1:] + over_d[:, :-1])
    apart, both = d_by_q - q_by_d, 0.5 * (d_by_q + q_by_d)
    return Curl(float(np.sqrt(np.mean(apart**2))), float(np.sqrt(np.mean(both**2))))


def _noise(apart: ComplexArray, count: NDArray[np.intp]) -> tuple[float, float]:
    """Standard deviation of one point in both axes, by points that were measured more than once
    or mirrored.
    """
    several = count > 1
    free = float(np.sum(1.0 - 1.0 / count[several])) if several.any() else 0.0
    if free < 3.0:
        return float("nan"), float("nan")
    left = apart[several]
    return (
        float(np.sqrt(np.sum(left.real**2) / free)),
        float(np.sqrt(np.sum(left.imag**2) / free)),
    )


def _said(
    model: _Model,
    parameters: list[Parameter],
    covariance: FloatArray,
    residuals: FloatArray,
    freedom: float,
    one_out: float,
    table: FluxTable,
    curl: Curl | None,
) -> Analysis:
    rows = model.rows
    whole = np.full((len(parameters), len(parameters)), np.nan)
    whole[: len(model.keys), : len(model.keys)] = covariance
    rms = float(np.sqrt(np.mean(residuals**2)))
    remarks = [
        (
            f"map of {table.i_d.size} points; standard deviations of {_size(table.sigma_d)} and "
            f"{_size(table.sigma_q)} mV s (median of psi_d, psi_q)"
        ),
        (
            f"a strictly reciprocal spline leaves {1e3 * rms:.2g} mV s at the points, "
            f"{1e3 * one_out:.2g} mV s at points it was not fitted to; the map keeps the points"
        ),
    ]
    if curl is not None and curl.cross > 0.0:
        remarks.append(
            f"curl {1e3 * curl.rms:.2g} mH r.m.s. of {1e3 * curl.cross:.2g} mH cross inductance: "
            f"{100.0 * curl.rms / curl.cross:.2g} %, which a lossless machine does not have"
        )
    if "offset_q" not in model.keys:
        slowest = float(np.min(np.abs(rows.omega_e)))
        remarks.append(
            "one sign of the speed: an offset of u_q is in psi_d and not in its deviation, "
            f"{10.0 / slowest:.2g} mV s for each 10 mV; run the other way too"
        )
    if "encoder_angle" not in model.keys:
        remarks.append("the map holds the error of the encoder's angle: no points at +-i_q")
    left = []
    for place, run in enumerate(rows.runs):
        kept = np.tile(rows.series == place, 2)
        values = residuals[kept]
        size = float(np.sqrt(np.mean(values**2)))
        share = freedom * values.size / residuals.size
        left.append(RunResiduals(run, "psi", "V s", size, values.size // 2, share, values))
    knots = " x ".join(str(count - _DEGREE) for count in model.energy.counts)
    terms = (f"co-energy of {knots} intervals", *(_KEYS[key][0] for key in model.keys))
    return Analysis("flux-points", tuple(parameters), whole, tuple(left), tuple(remarks), (), terms)


def _size(sigma: FloatArray) -> str:
    return f"{1e3 * float(np.median(sigma)):.2g}"
