"""What was found about a flux map and done to it: noise, fit and its price,
asymmetry and the frame that removes it.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.names import FluxFitName, FluxSymmetry
from dqforge.machines.records import dataclass
from dqforge.machines.units.quantities import format_quantity

# Noise of the incremental inductances of a plain spline, over their mean, above which ``fit: auto``
# smooths.
NOISE_LIMIT = 0.03

# Difference of the two mutual inductances over the others above which it is told, and above which
# ``fit: auto`` smooths points that fill no grid.
NOTABLE_CURL = 0.05
MOST_PLACES = 8  # Faulty places that are named; of more, the number is told.
_NO_NOISE = 1e-9  # Noise in Wb that is none: digits of a computation.

_SHOWN_BY = {
    "repeats": "shown by repeated points",
    "symmetry": "shown by the two halves",
    "neighbours": "shown by neighbours",
    "residual": "shown by the residuals",
}


@dataclass(frozen=True, slots=True)
class FluxFit:
    """How the points became a map.

    ``wanted`` is the key, ``used`` what was done. ``noise`` is that of single points, None where
    nothing shows it, and ``inductance_noise`` what a plain spline makes of it, over the mean
    inductances. ``faults`` are the cells (i_d, i_q of their middle in A) where a plain spline is
    not admissible, ``fault_count`` how many there are. ``residual_rms`` and ``residual_largest`` in
    Wb, for psi_d and psi_q, are the distances of the smoothed map from the plain spline through the
    points, ``torque_rms`` and ``torque_largest`` what they make of the torque in N m per pole pair;
    0 where nothing was smoothed. ``freedom`` is the effective number of parameters. ``curl`` is the
    r.m.s. difference of the mutual inductances of the plain spline over the others, 0 on a grid.
    """

    wanted: FluxFitName
    used: FluxFitName
    noise: FluxNoise | None
    inductance_noise: float
    faults: tuple[tuple[float, float], ...] = ()
    fault_count: int = 0
    residual_rms: tuple[float, float] = (0.0, 0.0)
    residual_largest: tuple[float, float] = (0.0, 0.0)
    torque_rms: float = 0.0
    torque_largest: float = 0.0
    freedom: float = 0.0
    curl: float = 0.0


@dataclass(frozen=True, slots=True)
class FluxAsymmetry:
    """How far the halves i_q > 0 and i_q < 0 are from mirror images.

    At ``current`` A (peak), at the angle of the largest torque of the averaged map, the halves make
    ``positive`` and ``negative`` N m (magnitudes); ``torque_most`` is the largest difference at any
    angle of that current, to which the best one is blind where the frame is turned. ``largest`` and
    ``rms`` in Wb are half the distances of mirrored points. Turning the frame by ``angle`` rad
    (electrical) leaves ``rms_left`` Wb, ``torque_left`` N m of difference, and
    ``torque_most_left``.
    """

    symmetry: FluxSymmetry
    current: float
    current_name: str
    positive: float
    negative: float
    torque_most: float
    largest: float
    rms: float
    angle: float
    rms_left: float
    torque_left: float
    torque_most_left: float

    @property
    def torque(self) -> float:
        """Difference of the two torques in N m."""
        return self.positive - self.negative

    @property
    def share(self) -> float:
        """That over the mean of both."""
        return self.torque / (0.5 * (self.positive + self.negative))

    @property
    def share_left(self) -> float:
        """The same in the turned frame."""
        return self.torque_left / (0.5 * (self.positive + self.negative))

    @property
    def removes(self) -> bool:
        """Whether a turned frame removes most of the asymmetry."""
        return self.rms_left < 0.5 * self.rms


@dataclass(frozen=True, slots=True)
class FluxEvidence:
    """Of one file: its fit with torques in N m of the whole machine, and its asymmetry,
    None for a half plane.
    """

    source: str
    fit: FluxFit
    asymmetry: FluxAsymmetry | None
    pole_pairs: int

    @property
    def torque_residual(self) -> tuple[float, float]:
        """R.m.s. and largest torque in N m that smoothing costs against the plain spline."""
        return self.pole_pairs * self.fit.torque_rms, self.pole_pairs * self.fit.torque_largest

    def sentences(self) -> tuple[str, ...]:
        """All of it for people."""
        return (
            *_fit_sentences(self),
            *(() if self.asymmetry is None else _asymmetry_sentences(self.asymmetry)),
        )

    def short(self) -> tuple[str, ...]:
        """What a header says, in lines of at most 110 characters; nothing where all is plain."""
        return (
            *_short_fit(self),
            *(() if self.asymmetry is None else _short_asymmetry(self.asymmetry)),
        )


_DEGREES = 57.29577951308232


def places(points: tuple[tuple[float, float], ...], count: int) -> str:
    """Places of faults in A, and how many more there are."""
    listed = "; ".join(f"i_d = {i_d:.4g} A, i_q = {i_q:.4g} A" for i_d, i_q in points)
    return listed + (f"; and {count - len(points)} more" if count > len(points) else "")


def _noise_text(fit: FluxFit) -> str:
    if fit.noise is None:
        return "nothing shows the noise of the points"
    if fit.noise.largest < _NO_NOISE:
        return f"the points have no noise ({_SHOWN_BY[fit.noise.source]})"
    size = (
        f"{format_quantity(fit.noise.d, 'Wb', 2)} in psi_d, "
        f"{format_quantity(fit.noise.q, 'Wb', 2)} in psi_q"
    )
    return f"the noise of the points is {size} ({_SHOWN_BY[fit.noise.source]})"


def _fit_sentences(evidence: FluxEvidence) -> tuple[str, ...]:
    fit = evidence.fit
    share = f"{100.0 * fit.inductance_noise:.2g} % of the incremental inductances of a plain spline"
    if fit.used == "interpolate":
        quiet = fit.noise is None or fit.inductance_noise <= 1e-3
        noise = (
            ()
            if quiet
            else (f"a plain spline interpolates the points: {_noise_text(fit)}, {share}",)
        )
        if fit.fault_count:
            where = places(fit.faults, fit.fault_count)
            noise = (
                *noise,
                (
                    f"the plain spline has no positive definite inductances in {fit.fault_count} "
                    f"cells: {where}"
                ),
            )
        return noise
    why = "flux_map.fit requests it"
    if fit.wanted == "auto":
        over = (
            f"{share}, more than {100.0 * NOISE_LIMIT:.0f} %"
            if fit.inductance_noise > NOISE_LIMIT
            else share
        )
        why = _noise_text(fit)
        if fit.noise is None or fit.noise.largest >= _NO_NOISE:
            why += f", {over}"
        if fit.fault_count:
            why += f"; the plain spline is not admissible in {fit.fault_count} cells: " + places(
                fit.faults, fit.fault_count
            )
        if fit.curl > NOTABLE_CURL:
            why += (
                f"; among the points d psi_d/d i_q and d psi_q/d i_d of the plain spline differ by "
                f"{100.0 * fit.curl:.2g} % of the inductances"
            )
    elif fit.noise is not None:
        why += f"; {_noise_text(fit)}"
    sizes = [
        f"{name} {format_quantity(rms, 'Wb', 3)} r.m.s., {format_quantity(most, 'Wb', 3)} at most"
        for name, rms, most in zip(
            ("psi_d", "psi_q"), fit.residual_rms, fit.residual_largest, strict=True
        )
    ]
    rms, most = (format_quantity(value, "N m", 3) for value in evidence.torque_residual)
    return (
        f"the map was smoothed (fit: smooth): {why}",
        (
            f"cost of smoothing over the plain spline: {', '.join(sizes)}; torque {rms} "
            f"r.m.s., {most} at most"
        ),
    )


def _short_fit(evidence: FluxEvidence) -> tuple[str, ...]:
    fit = evidence.fit
    if fit.used == "interpolate":
        return ()
    rms, most = (format_quantity(value, "N m", 3) for value in evidence.torque_residual)
    noise = ""
    if fit.noise is not None and fit.noise.largest >= _NO_NOISE:
        noise = f" of noise {format_quantity(fit.noise.largest, 'Wb', 2)}"
    return (
        f"Flux map: a smooth co-energy through points{noise};",
        f"the torque is {rms} (r.m.s.), at most {most} from that of the plain spline.",
    )


def _torques(found: FluxAsymmetry) -> str:
    return (
        f"{format_quantity(found.positive, 'N m', 4)} for i_q > 0, "
        f"{format_quantity(found.negative, 'N m', 4)} for i_q < 0"
    )


_DONE = {
    "average": "both halves were averaged",
    "keep": "both halves are kept",
    "positive": "the half i_q > 0 was used for both",
    "negative": "the half i_q < 0 was used for both",
}


def _asymmetry_sentences(found: FluxAsymmetry) -> tuple[str, ...]:
    size = f"{format_quantity(abs(found.torque), 'N m', 3)}, {100.0 * abs(found.share):.2g} %"
    most, rms, largest = (
        format_quantity(value, unit, 3)
        for value, unit in ((found.torque_most, "N m"), (found.rms, "Wb"), (found.largest, "Wb"))
    )
    first = (
        f"asymmetry of the halves at the {found.current_name} of "
        f"{format_quantity(found.current, 'A', 4)} (peak): {_torques(found)}: {size}, at most "
        f"{most} at any angle; in flux linkage {rms} r.m.s., {largest} at most; "
        f"{_DONE[found.symmetry]} (flux_map.symmetry)"
    )
    degrees = f"{found.angle * _DEGREES:.3g} deg electrical"
    left = (
        f"leaves {format_quantity(found.rms_left, 'Wb', 3)} r.m.s. and "
        f"{format_quantity(abs(found.torque_left), 'N m', 3)}, {100.0 * abs(found.share_left):.2g} "
        f"%, at most {format_quantity(found.torque_most_left, 'N m', 3)} at any angle"
    )
    if found.removes:
        advice = (
            f"the angle sensor looks misaligned: write frame_angle: {found.angle * _DEGREES:.3g} "
            "deg"
        )
        return first, f"a frame turned by {degrees} removes most of it and {left}; {advice}"
    return first, f"no turned frame removes it: the best, {degrees}, {left}"


def _short_asymmetry(found: FluxAsymmetry) -> tuple[str, ...]:
    size = f"{format_quantity(abs(found.torque), 'N m', 3)} ({100.0 * abs(found.share):.2g} %)"
    left = format_quantity(abs(found.torque_left), "N m", 3)
    return (
        (
            f"Flux map, at {format_quantity(found.current, 'A', 4)} (peak): {_torques(found)}, "
            f"{size} apart;"
        ),
        (
            f"{_DONE[found.symmetry]}; a frame turned by {found.angle * _DEGREES:.3g} deg el. "
            f"would leave {left}."
        ),
    )


# How noisy the points of a flux map are: by repeated points, by mirror symmetry,
# by differences of neighbours.
#
# Smooth deviations, such as those of a frame that is turned or of an iron core that is not
# symmetric, are no noise.

NoiseSource = Literal["repeats", "symmetry", "neighbours", "residual"]
_FEWEST_REPEATS = 8
_NORMAL_MEDIAN = 0.6745  # Median of the magnitude of a normal variable of unit variance.

# Sum of the squares of (1, -4, 6, -4, 1): the variance of a fourth difference over that of the
# points.
_FOURTH = 70.0
_SMOOTH_ORDER = 4
_FEWEST_MIRRORED = 40


@dataclass(frozen=True, slots=True)
class FluxNoise:
    """Standard deviation of single points in Wb, of psi_d and psi_q, and what shows it."""

    d: float
    q: float
    source: NoiseSource

    @property
    def largest(self) -> float:
        """The larger one in Wb."""
        return max(self.d, self.q)


def noise_of_repeats(
    i_d: FloatArray, i_q: FloatArray, psi: FloatArray, tolerance: float
) -> FluxNoise | None:
    """Noise by the scatter of points given repeatedly, pooled; None where fewer than 8 tell it.

    ``i_d``, ``i_q`` in A of shape (K,), ``psi`` in Wb of shape (2, K); currents within
    ``tolerance`` A are the same.
    """
    keys = np.round(np.stack([i_d, i_q]) / tolerance)
    _, group, counts = np.unique(keys, axis=1, return_inverse=True, return_counts=True)
    freedom = i_d.size - counts.size
    if freedom < _FEWEST_REPEATS:
        return None
    group = group.ravel()
    means = np.stack([np.bincount(group, part) / counts for part in psi])
    spread = np.sqrt(np.sum((psi - means[:, group]) ** 2, axis=1) / freedom)
    return FluxNoise(float(spread[0]), float(spread[1]), "repeats")


def _robust(values: FloatArray) -> float:
    """Standard deviation of a normal variable by the median of its magnitude,
    which outliers do not move.
    """
    return float(np.median(np.abs(values))) / _NORMAL_MEDIAN if values.size else float(np.inf)


def _of_neighbours(axis: FloatArray, values: FloatArray) -> float:
    """Noise by fourth differences along the first axis, where its points are evenly spaced;
    inf where it cannot.
    """
    steps = np.diff(axis)
    if axis.size < 5 or np.max(np.abs(steps - np.mean(steps))) > 1e-3 * np.mean(steps):
        return np.inf
    return _robust(np.diff(values, 4, axis=0)) / float(np.sqrt(_FOURTH))


def noise_of_neighbours(i_d: FloatArray, i_q: FloatArray, psi: FloatArray) -> FluxNoise | None:
    """Noise of a grid (2, M, N) by the differences of neighbours, along the axis that shows less.

    None otherwise.

    Curvature makes differences, too, most of all on coarse grids;
    it does so along one axis more than along the other.
    """
    found = [min(_of_neighbours(i_d, part), _of_neighbours(i_q, part.T)) for part in psi]
    return FluxNoise(found[0], found[1], "neighbours") if np.all(np.isfinite(found)) else None


def _without_smooth_part(i_d: FloatArray, i_q: FloatArray, values: FloatArray) -> FloatArray:
    """What a polynomial of total degree 4 in both currents leaves of values, shape (K,).

    Scaled to its freedom.
    """
    x, y = i_d / np.max(np.abs(i_d)), i_q / np.max(np.abs(i_q))
    powers = [(a, b) for a in range(_SMOOTH_ORDER + 1) for b in range(_SMOOTH_ORDER + 1 - a)]
    terms = np.stack([x**a * y**b for a, b in powers], axis=1)
    rest = values - terms @ np.linalg.lstsq(terms, values, rcond=None)[0]
    return np.asarray(rest * np.sqrt(values.size / (values.size - len(powers))))


def noise_of_symmetry(i_d: FloatArray, i_q: FloatArray, psi: FloatArray) -> FluxNoise | None:
    """Noise of a grid (2, M, N) over a whole plane by the two halves, less their smooth difference.

    None otherwise.
    """
    upper = i_q > 0.0
    if np.max(np.abs(i_q + i_q[::-1])) > 1e-6 * np.max(np.abs(i_q)) or i_d.size * np.count_nonzero(
        upper
    ) < (_FEWEST_MIRRORED):
        return None
    mirrored = psi[:, :, ::-1] * np.array([1.0, -1.0])[:, np.newaxis, np.newaxis]
    apart = ((psi - mirrored) / np.sqrt(2.0))[:, :, upper].reshape(2, -1)
    at = [part.ravel() for part in np.meshgrid(i_d, i_q[upper], indexing="ij")]
    found = [_robust(_without_smooth_part(at[0], at[1], part)) for part in apart]
    return FluxNoise(found[0], found[1], "symmetry")


def noise_of_grid(i_d: FloatArray, i_q: FloatArray, psi: FloatArray) -> FluxNoise | None:
    """Noise of a grid (2, M, N) in Wb as its halves show it, unless neighbours show less.

    None where neither can.

    The halves of computed maps are mirror images to the last digit: what they show then is no
    noise, nor is it more than the points of a half plane show, which is found from neighbours
    alone.
    """
    neighbours, symmetry = noise_of_neighbours(i_d, i_q, psi), noise_of_symmetry(i_d, i_q, psi)
    if symmetry is None or neighbours is None:
        return neighbours if symmetry is None else symmetry
    same = symmetry.largest <= 1e-6 * float(np.max(np.abs(psi)))
    if same or symmetry.largest > neighbours.largest:
        return neighbours
    return symmetry


def inductance_noise(noise: FluxNoise, i_d: FloatArray, i_q: FloatArray, psi: FloatArray) -> float:
    """Noise of the incremental inductances of a spline through a grid over their mean:
    flux noise per rise of a step.

    ``psi`` has the shape (2, M, N); the mean rise per step is that of the corner to corner means.
    """
    rise_d = float(np.mean(psi[0, -1] - psi[0, 0])) / (i_d.size - 1)
    rise_q = float(np.mean(psi[1, :, -1] - psi[1, :, 0])) / (i_q.size - 1)
    return max(noise.d / max(rise_d, 1e-300), noise.q / max(rise_q, 1e-300))
