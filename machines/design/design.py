"""A complete design: the drive, what is asked of it, and where every value came from."""

from __future__ import annotations

from dataclasses import field

from dqforge.machines.design.settings import (
    ChoiceSettings,
    ControlSettings,
    ExportSettings,
    FitSettings,
    LossSettings,
    OperationSettings,
    WaveformSettings,
    WeakeningSettings,
)
from dqforge.machines.design.values import InputValue
from dqforge.machines.devices.inverter import Inverter
from dqforge.machines.dq_machines.synchronous import Machine
from dqforge.machines.flux_maps.evidence import FluxEvidence
from dqforge.machines.losses.machine_budget import WindingHeat
from dqforge.machines.losses.machine_loss import MachineLoss
from dqforge.machines.names import Strategy
from dqforge.machines.phase_machines.salient_phase_machine import AnyPhaseMachine
from dqforge.machines.places import Places
from dqforge.machines.plants.scenario import Scenario
from dqforge.machines.records import dataclass
from dqforge.machines.topologies.linear_range import amplitude_limit


@dataclass(frozen=True, slots=True)
class DesignFiles:
    """What a design was read from: the bytes of its file, and those of each file that it names,
    by that name.
    """

    text: bytes
    named: tuple[tuple[str, bytes], ...] = ()


@dataclass(frozen=True, slots=True)
class Design:
    """Everything one design file says, in SI units.

    ``machine`` is the drive in dq coordinates, of a machine with another than sinusoidal back-EMF
    its fundamental; ``phase_machine`` holds that back-EMF and any saliency, None for all others.
    ``values`` lists each quantity with its origin, ``assumptions`` the sentences on what the file
    leaves open, ``digest`` is the SHA-256 of the file's bytes in hexadecimal. ``weakening`` asks
    for two-dimensional references, ``modulation_choice`` for a choice of modulator and switching
    frequency.
    ``winding`` says how warm the losses make the winding, None where its temperature is given.
    ``simulation`` asks for a simulation in the time domain. ``given`` is what it was read from,
    None where it was made in Python. ``flux_evidence`` is what was found about each file of a flux
    map. ``halves`` are the machines that the current references of positive and of negative torque
    are made for, the second one mirrored in i_q and in the torque; None where one machine serves
    both. ``places`` says where its keys stand in its file, None for designs made by hand; it is no
    part of what makes two designs equal.
    """

    name: str
    about: str
    machine: Machine
    machine_loss: MachineLoss
    phase_machine: AnyPhaseMachine | None
    inverter: Inverter
    control: ControlSettings
    operation: OperationSettings
    fit: FitSettings
    losses: LossSettings | None
    waveform: WaveformSettings
    export: ExportSettings
    values: tuple[InputValue, ...]
    assumptions: tuple[str, ...]
    digest: str
    weakening: WeakeningSettings | None = None
    winding: WindingHeat | None = None
    simulation: Scenario | None = None
    modulation_choice: ChoiceSettings | None = None
    given: DesignFiles | None = None
    flux_evidence: tuple[FluxEvidence, ...] = ()
    halves: tuple[Machine, Machine] | None = None
    places: Places | None = field(default=None, compare=False, repr=False)

    def __repr__(self) -> str:
        """Name, machine and inverter in a few lines; `values` says all that the file says."""
        machine = self.machine if self.phase_machine is None else self.phase_machine
        inverter = f"{self.inverter.v_dc:g} V, {self.inverter.f_sw:g} Hz"
        return f"Design {self.name!r}\n  {machine!r}\n  {inverter}, digest {self.digest[:12]}"

    @property
    def strategy(self) -> Strategy:
        """Which currents make the torque."""
        return self.operation.strategy

    @property
    def i_max(self) -> float:
        """Current limit in A (peak): the smaller of machine and inverter."""
        limits = [self.machine.i_max] + (
            [] if self.inverter.i_max is None else [self.inverter.i_max]
        )
        return min(limits)

    @property
    def v_max(self) -> float:
        """Phase amplitude in V (peak) that the currents may ask for: the linear range of
        topology and modulator less the margin.
        """
        return amplitude_limit(
            self.inverter, self.operation.modulation, self.operation.voltage_margin
        )
