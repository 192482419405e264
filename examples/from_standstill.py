# %% [markdown]
# # From standstill without an encoder: drives of the library
#
# A salient machine finds its rotor by an injected voltage, a strongly saturated one likewise on
# gentler terms, a machine without saliency is pulled along by a current that turns, and one whose
# back-EMF has a third harmonic runs on that once it turns. The emitted C runs each of them.

# %%
import math
from pathlib import Path
from typing import Any

from matplotlib import pyplot as plt

import dqforge

RPM = math.pi / 30.0


def course(duration: float, *points: tuple[float, float], **others: Any) -> dict[str, Any]:
    """A scenario with a speed reference through points (s, rpm), with straight lines between."""
    speeds = [{"time": time, "speed": speed * RPM} for time, speed in points]
    return {"duration": duration, "speed": {"points": speeds, "shape": "linear"}, **others}


resting = {"encoder": "none", "initial": {"angle": "100 deg"}}
loops: dict[str, Any] = {
    "control.current_loop": {"method": "magnitude-optimum"},
    "control.speed_loop": {"method": "symmetrical-optimum", "ratio": 10},
    "control.observer": {"method": "flux"},
    "export.control": "float32",
}

# %% [markdown]
# ## Three ways to leave standstill
#
# `control.start_up.observer` holds from rest, `control.observer` at speed; the plan of the start
# has the rest: polarity, hand-over in both directions, currents, time limits. The saturated
# machine hands over early and follows a slope: its flux observer knows one load alone.

# %%
injection = {"method": "injection"}
settings = {
    "abb-ipmsm-2k2": loops
    | {
        "control.start_up": {"method": "saliency", "observer": injection, "load_torque": 3.0},
        "simulation": course(1.5, (0.0, 1000.0), **resting),
    },
    "baldor-pmsyrm-5k6": loops
    | {
        "control.start_up": {"method": "saliency", "observer": injection, "hand_over": 390.0 * RPM},
        "simulation": course(3.8, (0.0, 0.0), (0.3, 0.0), (3.3, 1000.0), **resting),
    },
    "paper001-pmsm-bench": loops
    | {
        "control.start_up": {"method": "i-f", "load_torque": 0.1, "hand_over": 900.0 * RPM},
        "simulation": course(1.5, (0.0, 1500.0), **resting),
    },
}
drives = {}
for name, changes in settings.items():
    drive = dqforge.simulate(dqforge.load_design(name, changes))
    start = drive.to_dict()["start"]
    print(
        f"{name}: {start['state']} at {drive.omega_m[-1] / RPM:.1f} rpm, on its observer from "
        f"{start['hand_over_s']:.3f} s, faults: {len(start['failed'])}"
    )
    drives[name] = drive

# %% [markdown]
# ## By the third harmonic
#
# A machine with another back-EMF than a sine follows a current that turns until the third harmonic
# of its phase voltages can be heard, and then that.

# %%
third = {
    "inverter.topology": "three-wire",
    "control.current_loop": {"method": "bandwidth", "bandwidth": "300 Hz"},
    "control.speed_loop": {"method": "bandwidth", "bandwidth": 12.0, "ratio": 10},
    "control.observer": {"method": "third-harmonic"},
    "control.start_up": {"method": "i-f", "load_torque": 0.5},
    "export.control": "float32",
    "simulation": course(3.5, (0.0, 1200.0), **resting),
}
name = "paper002-phase-waveforms"
drives[name] = dqforge.simulate(dqforge.load_design(name, third))
print(f"{name}: {drives[name].omega_m[-1] / RPM:.1f} rpm on its third harmonic")

# %% [markdown]
# ## All of them

# %%
figure, axes = plt.subplots(2, 2, figsize=(9.0, 5.0), layout="constrained")
for ax, (name, drive) in zip(axes.flat, drives.items(), strict=True):
    run = drive.found.run
    ax.plot(drive.t, drive.reference / RPM, color="0.6", label="reference")
    ax.plot(drive.t, drive.omega_m / RPM, label="speed")
    ax.plot(drive.t, run.omega_m_observed / RPM, linewidth=0.7, label="estimate")
    ax.set(title=name, xlabel="Time in s", ylabel="rpm")
axes[0, 0].legend(frameon=False)
figure.savefig(Path("from-standstill.svg"))
