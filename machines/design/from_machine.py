"""A complete design from a machine that was built in Python, or drawn at random for trials: its
design file is written, and read as any other.

So the same checks, defaults and remarks hold as for a file, and what is emitted can
be computed again from it.
"""

from __future__ import annotations

import hashlib
import io
import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import yaml

from dqforge.machines.design.catalogue import load_text
from dqforge.machines.design.design import Design
from dqforge.machines.dq_machines.flux_map import FluxMap, SaturatedMachine
from dqforge.machines.dq_machines.synchronous import LinearMachine, torque_per_ampere
from dqforge.machines.errors import InputError
from dqforge.machines.files.scratch import scratch_folder
from dqforge.machines.phase_machines.phase_machine import PhaseMachine
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import linear_voltage

SOURCE = "design made in Python"  # What messages call the file, which nobody has seen.
MAP_FILE = "flux-map.npz"
_MOST_HARMONICS = 100
_LEAST_SHARE = 1e-12
BuiltMachine = LinearMachine | SaturatedMachine | PhaseMachine


def make_design(
    machine: BuiltMachine,
    /,
    *,
    v_dc: float,
    f_sw: float,
    name: str = "Machine from Python",
    prefix: str = "motor",
    **sections: Mapping[str, Any],
) -> Design:
    """A design of a machine from numbers and arrays, with everything that
    a design file can ask for.

    Args:
        machine: Constant inductances, a flux map, or a back-EMF of any shape with three equal
            phases.
        v_dc: Voltage of the dc link in V.
        f_sw: Switching frequency in Hz; the currents are sampled as often unless ``control`` says
            otherwise.
        name: Title of the drive.
        prefix: First part of every name in the C code, a C identifier.
        sections: Sections of the design file by name, as mappings of their keys, over what the
            numbers say: ``fit={"degree": 3}``, ``machine={"rated": {"torque": 20.0}}``,
            ``control={"current_loop": {"method": "bandwidth", "bandwidth": 2000.0}}``,
            ``inverter={"dead_time": 1e-6}``. Numbers are in SI units (rad/s for speeds and
            bandwidths).

    Returns:
        As `load_design` reads it; ``design.given`` holds the file that was written.

    Raises:
        InputError: A number or a key is not what the design file permits; the message names the
            key.
    """
    if not isinstance(machine, LinearMachine | SaturatedMachine | PhaseMachine):
        raise InputError(
            "machine: expected a LinearMachine, SaturatedMachine or PhaseMachine, got "
            f"{type(machine).__name__}"
        )
    content: dict[str, Any] = {
        "dqforge": 1,
        "name": name,
        "machine": _machine(machine),
        "inverter": {
            "v_dc": _quantity(v_dc, "V", "v_dc"),
            "switching_frequency": _quantity(f_sw, "Hz", "f_sw"),
        },
        "export": {"prefix": prefix},
    }
    _merge(content, {key: python_values(value) for key, value in sections.items()})
    text = yaml.safe_dump(content, sort_keys=False, allow_unicode=True, width=100).encode("utf-8")
    if not isinstance(machine, SaturatedMachine):
        return load_text(text, SOURCE)
    with scratch_folder() as folder:
        (folder / MAP_FILE).write_bytes(_map_bytes(machine.flux_map))
        loaded = load_text(text, SOURCE, folder)
    return loaded if machine.flux_map.hull is None else _with_hull(loaded, machine)


def _with_hull(loaded: Design, machine: SaturatedMachine) -> Design:
    """The design with the machine as it is: a file of its nodes does not say where in
    their rectangle data are.
    """
    whole = hashlib.sha256(loaded.digest.encode("ascii"))
    for corners in (machine.region.corner_d, machine.region.corner_q) if machine.region else ():
        whole.update(np.ascontiguousarray(corners).tobytes())
    return replace(loaded, machine=machine, digest=whole.hexdigest(), given=None)


def _quantity(value: float, unit: str, name: str) -> str:
    """A number with its unit, as it reads back to the same number."""
    if isinstance(value, bool) or not isinstance(value, int | float | np.integer | np.floating):
        raise InputError(f"{name}: expected a number in {unit}, got {type(value).__name__}")
    if not math.isfinite(value):
        raise InputError(f"{name}: expected a finite number in {unit}, got {value}")
    return f"{float(value)!r} {unit}"


def _of_kind(kind: str, value: float, unit: str, name: str) -> dict[str, str]:
    """A number with its unit and its convention, of which a file would otherwise remark
    that it is the usual one.
    """
    return {"value": _quantity(value, unit, name), "kind": kind}


def _machine(machine: BuiltMachine) -> dict[str, Any]:
    """The section ``machine``."""
    common: dict[str, Any] = {
        "pole_pairs": python_values(machine.pole_pairs),
        "resistance": _of_kind("phase", machine.r_s, "Ohm", "r_s"),
        "max_current": _of_kind("peak", machine.i_max, "A", "i_max"),
    }
    if isinstance(machine, PhaseMachine):
        return {"model": "waveform", **common, **_phases(machine)}
    if machine.inertia is not None:
        common["inertia"] = _quantity(machine.inertia, "kg m^2", "inertia")
    if machine.friction:
        common["friction"] = _quantity(machine.friction, "N m s", "friction")
    if machine.omega_m_max is not None:
        common["max_speed"] = _quantity(machine.omega_m_max, "rad/s", "omega_m_max")
    if isinstance(machine, SaturatedMachine):
        flux_map = {
            "file": MAP_FILE,
            "fit": "interpolate",
            "extrapolate": machine.flux_map.extrapolate,
        }
        return {"model": "flux-map", **common, "flux_map": flux_map}
    return {
        "model": "linear",
        **common,
        "inductance_d": _of_kind("phase", machine.l_d, "H", "l_d"),
        "inductance_q": _of_kind("phase", machine.l_q, "H", "l_q"),
        "magnet_flux": _of_kind("peak", machine.psi_pm, "Wb", "psi_pm"),
    }


def _phases(machine: PhaseMachine) -> dict[str, Any]:
    """Inductances and back-EMF of three equal phases."""
    if machine.symmetry == "none":
        raise InputError(
            "flux: the three phases differ; take machine.symmetrised(), or name a capture in a file"
        )
    count, turns = machine.angles, machine.turns
    most = min(count // 2, turns * _MOST_HARMONICS + 1)
    terms = 2.0 / count * np.fft.rfft(machine.flux[0])[1:most]
    turned = terms / 1j
    largest = float(np.max(np.abs(turned)))
    harmonics = [
        {
            "order" if turns == 1 else "mechanical_order": order,
            "amplitude": _quantity(float(abs(term)), "Wb", "flux"),
            "phase": _quantity(float(-np.angle(term)), "rad", "flux"),
        }
        for order, term in enumerate(turned.tolist(), start=1)
        if abs(term) > _LEAST_SHARE * largest
    ]
    return {
        "self_inductance": _of_kind("phase", machine.l_s, "H", "l_s"),
        "mutual_inductance": _quantity(machine.m_s, "H", "m_s"),
        "back_emf": {"harmonics": harmonics},
    }


def _map_bytes(flux_map: FluxMap) -> bytes:
    """The nodes of a map as a NumPy archive, which holds every digit."""
    content = io.BytesIO()
    np.savez_compressed(
        content, i_d=flux_map.i_d, i_q=flux_map.i_q, psi_d=flux_map.psi_d, psi_q=flux_map.psi_q
    )
    return content.getvalue()


def _merge(content: dict[str, Any], further: Mapping[str, Any]) -> None:
    """Add keys to nested mappings; what is given later counts."""
    for key, value in further.items():
        below = content.get(key)
        if isinstance(below, dict) and isinstance(value, dict):
            _merge(below, value)
        else:
            content[key] = value


def python_values(value: Any) -> Any:
    """A value for a design file: numbers and arrays of NumPy as those of Python."""
    if isinstance(value, Mapping):
        return {str(key): python_values(entry) for key, entry in value.items()}
    if isinstance(value, np.ndarray):
        return python_values(value.tolist())
    if isinstance(value, list | tuple):
        return [python_values(entry) for entry in value]
    return value.item() if isinstance(value, np.generic) else value


# Permanent-magnet drives drawn at random, from small 24 V motors to 560 V drives.
#
# What is drawn is relative: resistance and inductance as shares of the rated impedance, the
# inertia as the time in which rated torque reaches rated speed. The magnet flux follows from the
# rated voltage v_r = 0.9 v_dc / sqrt(3) at rated speed and rated current in the q axis:
#
#     (omega psi + R I)^2 + (omega L_d I)^2 = v_r^2
#
# (of salient machines with L_d: they reach rated speed with a negative d current). The incremental
# inductance along d falls with a magnetising current by the share s at the rated one, psi_d = psi
# + L_d (i_d - s i_d^2/(2 I)).

LINKS = (24.0, 48.0, 325.0, 560.0)  # DC-link voltages in V.
LOW_VOLTAGE = 100.0  # Links below it in V are switched by MOSFETs with a short dead time.
_SHARE_WITHOUT_SALIENCY = 0.4
_VOLTAGE_USED = 0.9


@dataclass(frozen=True, slots=True)
class RandomDrive:
    """A drive with its rated point.

    Args:
        machine: Its constants; ``i_max`` is the rated current I in A, ``omega_m_max`` the rated
            speed.
        v_dc: DC-link voltage in V.
        f_s: Switching and sampling frequency in Hz.
        dead_time: In s.
        saturation: Share s by which the incremental d inductance falls at the rated current.
        theta_e: Electrical angle at rest in rad.
        seed: Of the noise of a run.
    """

    machine: LinearMachine
    v_dc: float
    f_s: float
    dead_time: float
    saturation: float
    theta_e: float
    seed: int

    @property
    def omega_rated(self) -> float:
        """Rated electrical speed in rad/s."""
        assert self.machine.omega_m_max is not None
        return self.machine.pole_pairs * self.machine.omega_m_max

    @property
    def torque_rated(self) -> float:
        """Torque of the rated current in the q axis, in N m."""
        return self.machine.torque_per_ampere * self.machine.i_max

    @property
    def saliency(self) -> float:
        """L_q/L_d."""
        return self.machine.l_q / self.machine.l_d


def _log_uniform(generator: np.random.Generator, low: float, high: float) -> float:
    return float(low * (high / low) ** generator.uniform())


def random_drive(number: int, seed: int = 1) -> RandomDrive:
    """One drive; the same for the same number and seed.

    Args:
        number: Which, from 0 on.
        seed: Of the series.
    """
    generator = np.random.default_rng([seed, number])
    v_dc = float(generator.choice(LINKS))
    current = _log_uniform(generator, 3.0, 80.0)
    pole_pairs = int(generator.integers(2, 8))
    omega = 2.0 * math.pi * _log_uniform(generator, 60.0, 350.0)
    resistance = _log_uniform(generator, 0.015, 0.12)
    reactance = _log_uniform(generator, 0.12, 0.5)
    round_rotor = generator.uniform() < _SHARE_WITHOUT_SALIENCY
    saliency = 1.0 if round_rotor else float(generator.uniform(1.1, 2.5))
    saturation = float(generator.uniform(0.05, 0.3))
    acceleration_time = _log_uniform(generator, 0.03, 0.5)
    f_s = _log_uniform(generator, 8e3, 20e3)
    theta_e = float(generator.uniform(-math.pi, math.pi))
    v_rated = _VOLTAGE_USED * linear_voltage(v_dc)
    impedance = v_rated / current
    psi_pm = v_rated / omega * (math.sqrt(1.0 - reactance**2) - resistance)
    omega_m = omega / pole_pairs
    machine = LinearMachine(
        pole_pairs=pole_pairs,
        r_s=resistance * impedance,
        l_d=reactance * impedance / omega,
        l_q=saliency * reactance * impedance / omega,
        psi_pm=psi_pm,
        i_max=current,
        inertia=torque_per_ampere(pole_pairs, psi_pm) * current * acceleration_time / omega_m,
        omega_m_max=omega_m,
    )
    dead_time = 0.5e-6 if v_dc < LOW_VOLTAGE else 3e-6
    noise_seed = int(generator.integers(1, 2**31))
    return RandomDrive(machine, v_dc, f_s, dead_time, saturation, theta_e, noise_seed)


def random_drives(count: int, seed: int = 1) -> tuple[RandomDrive, ...]:
    """The first drives of a series.

    Args:
        count: How many.
        seed: Of the series.
    """
    return tuple(random_drive(number, seed) for number in range(count))
