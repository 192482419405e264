"""The flux map in the machine's section of the design file."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from dqforge.machines.entries.kinds import (
    Angle,
    ColumnName,
    FileName,
    Listing,
    PointSpeed,
    Resistance,
    Section,
    Temperature,
)
from dqforge.machines.names import FluxAxes, FluxFitName, FluxScaling, FluxSymmetry, FluxTorque


class ColumnsSection(Section):
    """What a file calls the columns or arrays of a flux map, where their names are not
    recognised.
    """

    i_d: ColumnName | None = Field(default=None, description="name of the d current")
    i_q: ColumnName | None = Field(default=None, description="name of the q current")
    psi_d: ColumnName | None = Field(default=None, description="name of the d flux linkage")
    psi_q: ColumnName | None = Field(default=None, description="name of the q flux linkage")
    i: ColumnName | None = Field(
        default=None, description="name of the current's amplitude, in place of i_d and i_q"
    )
    beta: ColumnName | None = Field(default=None, description="name of the current's angle, with i")
    l_d: ColumnName | None = Field(
        default=None, description="name of the apparent d inductance, in place of psi_d"
    )
    l_q: ColumnName | None = Field(
        default=None, description="name of the apparent q inductance, in place of psi_q"
    )
    psi_m: ColumnName | None = Field(
        default=None, description="name of the magnets' flux linkage, with l_d and l_q"
    )
    torque: ColumnName | None = Field(default=None, description="name of the torque")
    angle: ColumnName | None = Field(
        default=None, description="name of the rotor angle; it is averaged over"
    )
    temperature: ColumnName | None = Field(
        default=None, description="name of the temperature; see at"
    )
    speed: ColumnName | None = Field(default=None, description="name of the speed; see at")
    v_d: ColumnName | None = Field(
        default=None, description="name of the d voltage of operating points, in place of psi_d"
    )
    v_q: ColumnName | None = Field(default=None, description="name of the q voltage, with v_d")
    frequency: ColumnName | None = Field(
        default=None, description="name of the electrical frequency, with v_d and v_q"
    )
    resistance: ColumnName | None = Field(
        default=None, description="name of the phase resistance, with v_d and v_q"
    )
    loss: ColumnName | None = Field(default=None, description="name of the total loss")
    efficiency: ColumnName | None = Field(default=None, description="name of the efficiency")


class FluxMapPointsSection(Section):
    """Which points of a file are wanted that holds several temperatures or speeds."""

    temperature: Temperature | None = Field(default=None, description="their temperature (degC)")
    speed: PointSpeed | None = Field(default=None, description="their speed (rad/s; write rpm)")


class FluxMapFileSection(Section):
    """One of several flux maps of the same machine."""

    file: FileName = Field(description="file beside the design file")
    magnet_temperature: Temperature = Field(
        description="temperature of the magnets in this map (degC)"
    )


class FluxMapSection(Section):
    """Flux linkages over the currents, in a file: CSV, xlsx, NPZ, MAT, HDF5, FEMAG or Twin
    Builder.
    """

    file: FileName | None = Field(
        default=None, description="file beside the design file, or in a folder below it"
    )
    files: Annotated[Listing[FluxMapFileSection], Field(min_length=2, max_length=20)] | None = (
        Field(
            default=None, description="several maps over the magnet temperature, in place of file"
        )
    )
    psi_q_file: FileName | None = Field(
        default=None,
        description="matrix of psi_q (i_d across, i_q down), where file holds that of psi_d alone",
    )
    torque_file: FileName | None = Field(default=None, description="matrix of the torque, likewise")
    axes: FluxAxes = Field(
        default="magnet-d",
        description=(
            "magnet-d: d along the magnets; reluctance: the magnets lie on the negative q axis"
        ),
    )
    scaling: FluxScaling = Field(
        default="peak", description="of currents and flux linkages: peak, rms, power-invariant"
    )
    quantities: Literal["line", "winding"] | None = Field(
        default=None,
        description=(
            "of a delta: whether the map holds currents of lines (as measured) or of windings"
        ),
    )
    current_unit: Literal["A", "mA", "kA"] | None = Field(
        default=None, description="where the file does not say it"
    )
    flux_unit: Literal["Wb", "mWb", "V s", "mV s"] | None = Field(
        default=None, description="where the file does not say it"
    )
    resistance: Resistance | None = Field(
        default=None,
        description=(
            "of a phase (Ohm), for operating points with voltages whose file does not give it, at "
            "the temperature of the file"
        ),
    )
    columns: ColumnsSection = Field(
        default_factory=ColumnsSection, description="names in the file, where they are unusual"
    )
    at: FluxMapPointsSection = Field(
        default_factory=FluxMapPointsSection,
        description="which temperature or speed, where the file holds several",
    )
    torque: FluxTorque = Field(
        default="air-gap",
        description=(
            "what the torque in the file is: air-gap; shaft: measured behind friction and iron "
            "loss; per-pole-pair; ignore"
        ),
    )
    extrapolate: bool = Field(
        default=False,
        description="permit currents beyond the map; results that use them are marked",
    )
    fit: FluxFitName = Field(
        default="auto",
        description=(
            "interpolate: a spline through the points; smooth: a smooth co-energy near them; auto: "
            "smooth where noise makes more than 3 % of the incremental inductances or one is not "
            "positive"
        ),
    )
    symmetry: FluxSymmetry = Field(
        default="average",
        description=(
            "of the halves i_q > 0 and i_q < 0: average; keep: a current reference for each sign "
            "of the torque; positive, negative: one half, mirrored"
        ),
    )
    frame_angle: Angle | None = Field(
        default=None,
        description=(
            "turn of the file's frame (rad electrical; write deg), against a misaligned sensor"
        ),
    )
