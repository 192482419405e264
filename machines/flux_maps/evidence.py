"""What was found about a flux map and done to it: noise, fit and its price,
asymmetry and the frame that removes it.
"""

from __future__ import annotations

from dqforge.machines.flux_maps.noise import FluxNoise
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
            else (f"a plain spline goes through the points: {_noise_text(fit)}, {share}",)
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
    why = "flux_map.fit asks for it"
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
            f"price of smoothing against the plain spline: {', '.join(sizes)}; torque {rms} "
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
