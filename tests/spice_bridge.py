"""A switched bridge in ngspice: switches with thresholds and resistances, diodes, gates with dead
time from a carrier, windings with a back-EMF.

The netlist knows nothing of ours but a machine's data and an operating point: references, zero
sequences and gates are sources of its own, and its devices are solved as a circuit.
"""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.devices.inverter import Inverter, SwitchDevice
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.names import ModulationName

_BACKWARDS = 1.0  # A, of a diode
_HIGH, _LOW = "max(v(ra),max(v(rb),v(rc)))", "min(v(ra),min(v(rb),v(rc)))"

# Zero sequences from the phase references, with half the link voltage.
_ZERO = {
    "spwm": "0",
    "svpwm": f"-0.5*({_HIGH}+{_LOW})",
    "dpwmmin": f"-{{half}}-{_LOW}",
    "dpwmmax": f"{{half}}-{_HIGH}",
}


@dataclass(frozen=True, slots=True)
class SpiceRun:
    """A fundamental period, N instants that are not even.

    ``t`` in s, shape (N,); ``v`` of the legs against the lower rail in V and ``i`` of the phases in
    A, shape (N, 3); ``link`` in A from the source, shape (N,); ``transistors`` and ``diodes`` in A,
    shape (N, 6).
    """

    t: FloatArray
    v: FloatArray
    i: FloatArray
    link: FloatArray
    transistors: FloatArray
    diodes: FloatArray

    def mean(self, values: FloatArray) -> FloatArray:
        """Over the period."""
        return np.asarray(np.trapezoid(values, self.t, axis=0) / (self.t[-1] - self.t[0]))

    def phasor(self, values: FloatArray) -> complex:
        """Fundamental of three phases, peak, from phase a at the start."""
        turn = np.exp(-2j * np.pi * (self.t - self.t[0]) / (self.t[-1] - self.t[0]))
        back = np.exp(2j * np.pi * np.arange(3) / 3.0)
        parts = [2.0 * self.mean(values[:, k] * turn) * back[k] for k in range(3)]
        return complex(np.mean(parts))

    def ripple(self) -> float:
        """R.m.s. of the phase currents in A above ten times the fundamental."""
        count = 2**15
        even = self.t[0] + (self.t[-1] - self.t[0]) * np.arange(count) / count
        square = 0.0
        for k in range(3):
            line = np.linspace(float(self.i[0, k]), float(self.i[-1, k]), count)
            wave = np.interp(even, self.t, self.i[:, k]) - line
            parts = np.fft.rfft(wave)[11:] / count
            square += 2.0 * float(np.sum(np.abs(parts) ** 2)) / 3.0
        return float(np.sqrt(square))

    def commutated(self, v_dc: float) -> float:
        """Sum of |i| in A over all commutations of all legs."""
        up = self.v > 0.5 * v_dc
        return float(np.sum(np.abs(self.i[1:]) * (up[1:] != up[:-1])))


def _half_bridge(leg: str, device: SwitchDevice) -> Iterator[str]:
    mosfet = device.kind == "mosfet"
    for place, top, bottom in (("u", "p", leg), ("l", leg, "0")):
        n = f"{leg}{place}"
        yield f"Vt{n} {top} t{n} {device.on_voltage:g}"
        yield f"St{n} t{n} {bottom if mosfet else f's{n}'} g{n} 0 SWITCH"
        if not mosfet:
            yield f"Dt{n} s{n} {bottom} IDEAL"
        yield f"Vd{n} {bottom} d{n} {device.diode_voltage:g}"
        yield f"Rd{n} d{n} e{n} {max(device.diode_resistance, 1e-6):g}"
        yield f"Dd{n} e{n} {top} IDEAL"


def netlist(
    machine: LinearMachine,
    inverter: Inverter,
    modulation: ModulationName,
    i: complex,
    frequency: float,
    steps: int = 400,
) -> str:
    """One period of the fundamental, begun with its own currents.

    Args:
        machine: L_d = L_q.
        i: Phase current, peak, against the back-EMF, which is the real axis.
        frequency: Of the fundamental in Hz.
        steps: In a period of the carrier, at least; edges lie within one of where they belong.
    """
    device, v_dc, carrier = inverter.device, inverter.v_dc, inverter.f_sw
    assert device is not None
    omega = 2.0 * np.pi * frequency
    emf = omega * machine.psi_pm
    v = emf + (machine.r_s + 1j * omega * machine.l_d) * i
    half, rise = 0.5 * v_dc, 0.5 / carrier

    def sine(phasor: complex, k: int) -> str:
        angle = np.degrees(np.angle(phasor)) + 90.0 - 120.0 * k
        return f"SIN(0 {abs(phasor):.9g} {frequency:g} 0 0 {angle:.9g})"

    # half the dead time moves each edge on the slope of the carrier: 2 v_dc in a period
    shift, rest = inverter.dead_time * carrier * v_dc, half * (1.0 - 1e-6)
    lines = [
        "* bridge",
        f"Vlink p 0 {v_dc:g}",
        f"Vcar car 0 PULSE({-half:g} {half:g} 0 {rise:g} {rise:g} 1p {2.0 * rise:g})",
        f"Bzero z 0 V={_ZERO[modulation].format(half=f'{half:g}')}",
    ]
    for k, leg in enumerate("abc"):
        start = (i * np.exp(-2j * np.pi * k / 3.0)).real
        # what the dead time takes is made up for: v_dc t_d f_sw in the direction of the current,
        # but of a leg that rests at a rail
        lines += [
            f"Vr{leg} r{leg} 0 {sine(v, k)}",
            f"Bw{leg} w{leg} 0 V=v(r{leg})+v(z)",
            f"Bm{leg} m{leg} 0 V=(i(Ve{leg})>0)?{shift:g}:{-shift:g}",
            f"Bc{leg} c{leg} 0 V=v(w{leg})*((abs(v(w{leg}))>{rest:.9g})?2:1)+v(m{leg})",
            f"Bgu{leg} g{leg}u 0 V=(v(c{leg})>v(car)+{shift:g})?1:0",
            f"Bgl{leg} g{leg}l 0 V=(v(c{leg})<v(car)-{shift:g})?1:0",
            *_half_bridge(leg, device),
            f"L{leg} {leg} x{leg} {machine.l_d:g} IC={start:.9g}",
            f"R{leg} x{leg} y{leg} {machine.r_s:g}",
            f"Ve{leg} y{leg} n {sine(emf, k)}",
        ]
    places = [f"{leg}{place}" for leg in "abc" for place in "ul"]
    columns = [
        *(f"v({leg})" for leg in "abc"),
        *(f"i(Ve{leg})" for leg in "abc"),
        "i(Vlink)",
        *(f"i(Vt{place})" for place in places),
        *(f"i(Vd{place})" for place in places),
    ]
    step = 1.0 / carrier / steps
    lines += [
        "Rn n 0 1e9",
        f".model SWITCH SW(RON={device.on_resistance:g} ROFF=1e7 VT=0.5 VH=0)",
        ".model IDEAL D(N=0.002 IS=1e-12 CJO=0)",
        ".options method=gear reltol=1e-4 abstol=1e-6 vntol=1e-6",
        ".control",
        f"tran {step:g} {1.0 / frequency:.12g} 0 {step:g} uic",
        "set wr_singlescale",
        f"wrdata found.txt {' '.join(columns)}",
        "quit",
        ".endc",
        ".end",
    ]
    return "\n".join([*lines, ""])


def run(folder: Path, text: str) -> SpiceRun:
    """What ngspice makes of a netlist.

    Args:
        folder: Where netlist and numbers are written.
        text: Of `netlist`.
    """
    (folder / "bridge.cir").write_text(text, encoding="ascii")
    done = subprocess.run(
        ["ngspice", "-n", "-b", "bridge.cir"], cwd=folder, capture_output=True, check=False
    )
    assert done.returncode == 0, done.stderr.decode()[-500:]
    found = np.loadtxt(folder / "found.txt")
    # where a channel takes over from a diode, single instants let the diode carry backwards
    found = found[np.all(found[:, 14:20] > -_BACKWARDS, axis=1)]
    return SpiceRun(
        found[:, 0], found[:, 1:4], found[:, 4:7], -found[:, 7], found[:, 8:14], found[:, 14:20]
    )
