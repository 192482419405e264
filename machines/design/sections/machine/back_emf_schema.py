"""The back-EMF in the machine's section of the design file."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from dqforge.machines.entries.kinds import (
    Angle,
    ChannelPlace,
    FileName,
    Flux,
    HarmonicShare,
    Listing,
    SampleInterval,
    Section,
)


class HarmonicSection(Section):
    """One harmonic of the back-EMF, e / omega_e = - sum A sin(h theta - phase); b and c lag
    by 120 and 240 deg.
    """

    order: int | None = Field(default=None, ge=1, le=200, description="order h")
    mechanical_order: int | None = Field(
        default=None,
        ge=1,
        le=4000,
        description=(
            "order of the mechanical angle, h times the pole pairs, in place of order: where pole "
            "pairs differ"
        ),
    )
    amplitude: Flux | None = Field(
        default=None, description="A (Wb = V s/rad electrical); kind peak (default) or rms"
    )
    share: HarmonicShare | None = Field(
        default=None, description="A over that of order 1 (write 18 %), in place of it"
    )
    phase: Angle | None = Field(default=None, description="phase (rad; write deg); default 0")


class BackEmfSection(Section):
    """Back-EMF of the three phases: harmonics, or a capture in one or several files."""

    harmonics: Annotated[Listing[HarmonicSection], Field(min_length=1, max_length=400)] | None = (
        Field(
            default=None,
            description=(
                "list of {order: 1, amplitude: 0.2 Wb}, {order: 3, share: 18 %, phase: 0 deg}"
            ),
        )
    )
    file: FileName | None = Field(
        default=None,
        description="capture beside the design file, in place of harmonics: text or .mat, also .gz",
    )
    files: Annotated[Listing[FileName], Field(min_length=2, max_length=3)] | None = Field(
        default=None,
        description="the files of a capture that has one for each channel, in place of file",
    )
    interval: SampleInterval | None = Field(
        default=None,
        description="time between two samples (s; write us), for captures that do not say it",
    )
    connection: ChannelPlace = Field(
        default="phase", description="what the channels measured: phase or line-to-line"
    )
    scale: Annotated[tuple[float, float, float], Field(strict=False)] = Field(
        default=(1.0, 1.0, 1.0), description="factors of the channels (probes)"
    )
    highest_order: int = Field(
        default=13, ge=1, le=100, description="highest harmonic taken from the file"
    )
    span: Literal["electrical", "mechanical"] = Field(
        default="electrical",
        description=(
            "what the waveform of the file repeats after: mechanical keeps what the pole pairs "
            "differ by"
        ),
    )
    symmetric: bool | None = Field(
        default=None,
        description=(
            "take the mean of the phases and half waves of the file; false keeps them as measured, "
            "as is the default over the mechanical span, where true takes the mean of the phases"
        ),
    )
