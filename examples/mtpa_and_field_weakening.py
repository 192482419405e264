# %% [markdown]
# # MTPA and field weakening of a library drive
#
# Which currents make a torque at least loss, at which speed the voltage begins to weaken the field,
# and what the drive can do at all. Everything is in SI units: N m, rad/s, A and V as peak of phase.

# %%
import numpy as np

import dqforge

print("library:", ", ".join(dqforge.library()))
design = dqforge.load_design("thor-pmsyrm-5k")
machine = design.machine
print(
    f"{design.name}: {machine.pole_pairs} pole pairs, up to {design.i_max:.3g} A at "
    f"{design.inverter.v_dc:.4g} V"
)

# %% [markdown]
# ## What it can do
#
# The figures hold within the linear range of space-vector modulation,
# with 5 % of the voltage kept for control.

# %%
drive = dqforge.characteristics(design, margin=0.05)
print(f"most torque   {drive.torque_max:8.2f} N m")
print(f"base speed    {drive.base_speed:8.1f} rad/s ({drive.base_speed * 30 / np.pi:.0f} rpm)")
print(f"most power    {drive.power_max:8.0f} W at {drive.power_speed:.0f} rad/s")

# %% [markdown]
# ## One torque over speed
#
# Up to the base speed the currents are those of MTPA; beyond, i_d grows more negative until
# the torque cannot be had.

# %%
torque = 0.6 * drive.torque_max
omega_m = np.array([0.5, 1.0, 1.5, 2.0, 3.0]) * drive.base_speed
points = dqforge.operating_points(design, torque, omega_m, margin=0.05)
print(" rad/s     N m     i_d     i_q  held by")
for k, speed in enumerate(omega_m):
    row = f"{speed:6.0f}  {points.torque[k]:6.2f}  {points.i_d[k]:6.2f}  {points.i_q[k]:6.2f}"
    print(f"{row}  {points.held_by[k]}")

# %% [markdown]
# ## The whole map
#
# Arrays over torque and speed; `to_xarray()` gives them names and units where xarray is installed.

# %%
chart = dqforge.operating_map(design, torques=30, speeds=40, margin=0.05)
fastest = chart.omega_m[-1]
print(
    f"{chart.points.i_d.shape} points up to {fastest:.0f} rad/s, "
    f"{np.mean(chart.points.reached):.0%} within reach"
)
chart.plot("efficiency.svg")
