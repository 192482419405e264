# %% [markdown]
# # Where the losses are: modulators, carriers, and the shape of the currents
#
# First a drive whose inverter is known: which modulator loses least where? Then a machine whose
# back-EMF, as an oscilloscope recorded it, is not sinusoidal: what do currents of the right shape
# save?

# %%
from pathlib import Path

import numpy as np

import dqforge

drive = dqforge.load_design("paper000-ipmsm-100kw")
at_point = dqforge.losses(
    drive, 130.0, 300.0, modulations=("spwm", "svpwm", "ddt-gdpwm"), strategies=("mtpa",)
)
for name, total in zip(at_point.modulations, at_point.total[0, :, 0], strict=True):
    print(f"{name:10} {total:7.1f} W at 130 N m and 300 rad/s")

# %% [markdown]
# ## Over torque and speed
#
# Modulators and switching frequencies are alternatives of one map;
# `best` is the index of the one that loses least.

# %%
chart = dqforge.loss_map(
    drive, 8, 10, modulations=("svpwm", "ddt-gdpwm"), strategies=("mtpa",), f_sw=(20e3, 100e3)
)
for index, (strategy, modulation, frequency) in enumerate(chart.labels):
    share = np.mean(chart.best == index)
    print(
        f"{strategy} {modulation:10} {frequency / 1e3:4.0f} kHz: best at {100 * share:3.0f} % of "
        "the points"
    )
chart.plot("losses.svg")

# %% [markdown]
# ## A capture of the back-EMF
#
# The recording is made here: 18 % of third and 6 % of fifth harmonic with noise,
# as a text file of an oscilloscope.

# %%
generator = np.random.default_rng(1)
time = np.arange(4000) * 20e-6
theta = 2.0 * np.pi * 50.0 * time
phases = [theta - k * 2.0 * np.pi / 3.0 for k in range(3)]
volts = [80.0 * (np.sin(a) + 0.18 * np.sin(3.0 * a) + 0.06 * np.sin(5.0 * a)) for a in phases]
columns = np.column_stack([time, *volts]) + generator.normal(0.0, 0.2, (4000, 4)) * [
    0.0,
    1.0,
    1.0,
    1.0,
]
np.savetxt(
    "capture.csv",
    columns,
    delimiter=",",
    header="time [s],a [V],b [V],c [V]",
    comments="",
    fmt="%.6g",
)

capture = dqforge.read_back_emf(Path("capture.csv"), pole_pairs=2)
shares = 100.0 * capture.result.amplitudes[0] / capture.result.amplitudes[0, 0]
print(f"psi_pm {capture.psi_pm:.4f} Wb, third harmonic {shares[2]:.1f} %, fifth {shares[4]:.1f} %")

# %% [markdown]
# ## Currents for it
#
# dq ignores the harmonics, dqx and dqy follow them; a four-leg inverter
# lets the zero sequence flow.

# %%
machine = capture.machine(pole_pairs=2, r_s=1.2, l_s=8e-3, m_s=-1e-3, i_max=8.0)
design = dqforge.make_design(machine, v_dc=300.0, f_sw=10e3, inverter={"topology": "four-leg"})
shaped = dqforge.waveforms(design, torque=1.5, omega_m=80.0)
for rule, found in shaped.rules.items():
    figures = found.figures
    print(f"{rule:8} copper {figures.copper[0]:6.2f} W, torque ripple {figures.ripple[0]:7.4f} N m")
shaped.plot("currents.svg")
