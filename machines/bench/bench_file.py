"""The bench file as a schema: what is known of machine and inverter, and the runs with their logs.

What stands under ``columns`` of a run is read by `dqforge.machines.bench.log_columns`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field, replace
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, WithJsonSchema

from dqforge.machines.arrays import BoolArray, FloatArray
from dqforge.machines.design.schema import named_schema
from dqforge.machines.entries.kinds import (
    About,
    BackEmfConstant,
    DeadTime,
    FileName,
    Flux,
    Friction,
    Inductance,
    Inertia,
    Listing,
    MachineCurrent,
    Name,
    PolePairs,
    Rate,
    Resistance,
    Section,
    Speed,
    SpeedConstant,
    TorqueConstant,
    Uncertainty,
    Voltage,
)
from dqforge.machines.errors import Places
from dqforge.machines.records import dataclass

RunKindName = Literal[
    "constant-speed",
    "flux-points",
    "speed-sweep",
    "offset-sweep",
    "voltage-speed",
    "locked-torque",
    "locked-voltage",
    "spin-up",
    "spin-down",
    "back-emf",
    "inverter-table",
]
LogFormat = Literal[
    "auto",
    "text",
    "npz",
    "hdf5",
    "mat",
    "parquet",
    "mdf",
    "tdms",
    "vesc-tool",
    "moteus-ld",
    "motortest",
]
CurrentSource = Literal["measured", "requested"]
VoltageSource = Literal["measured", "reference"]

_COLUMNS: dict[str, Any] = {
    "type": "object",
    "additionalProperties": {
        "anyOf": [
            {"type": "string"},
            {
                "type": "object",
                "properties": {
                    "column": {"type": "string"},
                    "unit": {"type": "string"},
                    "scale": {"type": "number"},
                    "value": {"type": ["number", "string"]},
                },
                "additionalProperties": False,
            },
        ]
    },
}
Columns = Annotated[dict[str, Any], WithJsonSchema(_COLUMNS)]


class KnownMachine(Section):
    """What is known of the machine, as a design writes it.

    It is compared with what the logs say, taken where a run needs it, and copied into the design
    where no run gives it.
    """

    pole_pairs: PolePairs = Field(description="number of pole pairs p")
    resistance: Resistance | None = Field(default=None, description="stator resistance (Ohm)")
    inductance: Inductance | None = Field(
        default=None, description="single inductance of a data sheet, for both axes (H)"
    )
    inductance_d: Inductance | None = Field(default=None, description="d-axis inductance (H)")
    inductance_q: Inductance | None = Field(default=None, description="q-axis inductance (H)")
    magnet_flux: Flux | None = Field(default=None, description="flux linkage of the magnets (Wb)")
    back_emf_constant: BackEmfConstant | None = Field(
        default=None, description="back-EMF per mechanical speed (write V/krpm), kind required"
    )
    torque_constant: TorqueConstant | None = Field(
        default=None, description="torque per ampere (N m/A), kind required"
    )
    kv: SpeedConstant | None = Field(
        default=None, description="speed per volt, the Kv of a hobby motor (rpm/V)"
    )
    inertia: Inertia | None = Field(
        default=None, description="moment of inertia of all that turns (kg m^2)"
    )
    friction: Friction | None = Field(default=None, description="viscous friction (N m s/rad)")
    max_current: MachineCurrent | None = Field(
        default=None, description="largest phase current (A)"
    )
    max_speed: Speed | None = Field(default=None, description="largest mechanical speed (rad/s)")


class KnownWidths(Section):
    """Half widths of the 95 % intervals of values under machine, as shares of them.

    What has one is averaged with what the runs say.
    """

    resistance: Uncertainty | None = Field(default=None, description="of the resistance")
    inductance_d: Uncertainty | None = Field(default=None, description="of the d-axis inductance")
    inductance_q: Uncertainty | None = Field(default=None, description="of the q-axis inductance")
    magnet_flux: Uncertainty | None = Field(
        default=None, description="of the flux linkage of the magnets, or the constant it is from"
    )
    inertia: Uncertainty | None = Field(default=None, description="of the moment of inertia")
    friction: Uncertainty | None = Field(default=None, description="of the viscous friction")


class KnownInverter(Section):
    """What is known of the inverter, for the design."""

    v_dc: Voltage | None = Field(default=None, description="DC-link voltage (V)")
    switching_frequency: Rate | None = Field(default=None, description="carrier frequency (Hz)")
    dead_time: DeadTime | None = Field(default=None, description="dead time (s)")


class RunSection(Section):
    """One run of the bench and its log."""

    name: Name = Field(description="what the run is called in the result")
    kind: RunKindName = Field(description="what was done")
    file: FileName | None = Field(default=None, description="the log, beside the bench file")
    files: Annotated[Listing[FileName], Field(min_length=2, max_length=8)] | None = Field(
        default=None, description="for offset-sweep: several logs of the same run"
    )
    format: LogFormat = Field(
        default="auto", description="auto: by the ending of the file; a text table otherwise"
    )
    columns: Columns = Field(
        default={},
        description=(
            "quantity: the column's name, or {column: name, unit: A, scale: 1}; a quantity that "
            "stood still: {value: 1000 rpm}"
        ),
    )
    currents: CurrentSource | None = Field(
        default=None,
        description="measured or requested; requested currents are refused, they are not those "
        "that flowed",
    )
    voltage: VoltageSource | None = Field(
        default=None,
        description="measured, or reference: what the controller asked the inverter for",
    )


class BenchFile(Section):
    """Runs of a bench and what is known of machine and inverter."""

    dqforge_bench: Literal[1] = Field(description="version of this format")
    name: Name = Field(description="one line that names the machine, at most 80 characters")
    about: About = Field(default="", description="a paragraph on the bench")
    machine: KnownMachine = Field(description="what is known of the machine")
    uncertainty: KnownWidths = Field(
        default_factory=KnownWidths,
        description="how well values under machine are known (95 % interval, both ways)",
    )
    inverter: KnownInverter = Field(
        default_factory=KnownInverter, description="what is known of the inverter"
    )
    runs: Annotated[Listing[RunSection], Field(min_length=1, max_length=200)] = Field(
        description="the runs"
    )


BENCH_SCHEMA_ID = "urn:dqforge:schema:bench:1"


def bench_json_schema() -> dict[str, Any]:
    """JSON Schema (draft 2020-12) of the bench file, for editors and for documentation."""
    return named_schema(BenchFile, BENCH_SCHEMA_ID, "dqforge bench file")


# A bench as it was read: every column in SI units.


@dataclass(frozen=True, slots=True)
class LogPart:
    """One log: its name, the SHA-256 of its bytes in hexadecimal, and the asked columns that it
    has, in SI units and of one length.

    ``said`` are values that the log states of the machine, in SI units by the key of a design,
    with where they stand.
    """

    file: str
    sha256: str
    columns: Mapping[str, FloatArray]
    rows: NDArray[np.intp]
    said: Mapping[str, tuple[float, str]]


@dataclass(frozen=True, slots=True)
class LoggedRun:
    """A run: ``index`` is its place in the bench file, ``constants`` quantities that stood still,
    in SI units; ``steps`` those of columns whose rows are means, in SI units, where no mean is
    nearer than the step.
    """

    index: int
    name: str
    kind: RunKindName
    parts: tuple[LogPart, ...]
    constants: Mapping[str, float]
    voltage: VoltageSource | None
    remarks: tuple[str, ...] = ()
    steps: Mapping[str, float] | None = None

    @property
    def place(self) -> str:
        """What messages call the run."""
        return f"runs[{self.index}] ({self.name})"

    def column(self, quantity: str) -> FloatArray | None:
        """A quantity over the rows of the only log, shape (rows,); None where it has none."""
        part = self.parts[0]
        if quantity in part.columns:
            return part.columns[quantity]
        if quantity in self.constants:
            return np.full(part.rows.size, self.constants[quantity])
        return None

    def need(self, quantity: str) -> FloatArray:
        """As `column`, for a quantity that the kind of the run requires."""
        found = self.column(quantity)
        if found is None:
            raise KeyError(quantity)
        return found

    def some(self, kept: BoolArray, told: str) -> LoggedRun:
        """Those rows of the only log for which ``kept``, shape (rows,), is true, and a remark."""
        part = self.parts[0]
        columns = {name: values[kept] for name, values in part.columns.items()}
        less = replace(part, columns=columns, rows=part.rows[kept])
        return replace(self, parts=(less,), remarks=(*self.remarks, told))


@dataclass(frozen=True, slots=True)
class Bench:
    """A bench file that was read.

    ``about`` is the file's paragraph on the bench, ``source`` its name, ``digest`` the SHA-256 of
    its bytes in hexadecimal. ``known`` are values of the machine in SI units by the key of a
    design (magnet flux linkages of all constants under ``magnet_flux``), ``origins`` which key each
    comes from; ``entries`` what the file writes of machine and inverter, for a design; ``v_dc`` the
    voltage of the DC link in V, None where the file has none; ``widths`` half the 95 % intervals of
    values in ``known`` by key, in their units; ``places`` where its keys stand.
    """

    name: str
    about: str
    source: str
    digest: str
    pole_pairs: int
    known: Mapping[str, float]
    origins: Mapping[str, str]
    entries: Mapping[str, Mapping[str, Any]]
    v_dc: float | None
    widths: Mapping[str, float]
    runs: tuple[LoggedRun, ...]
    places: Places = field(repr=False)
