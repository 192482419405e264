# %% [markdown]
# # A machine from flux-map arrays
#
# Flux linkages from a test bench or a finite-element tool are arrays. Here they come from an
# analytic machine that saturates, so that the script needs no file; a measurement would take their
# place.

# %%
import numpy as np

import dqforge

i_d = np.linspace(-200.0, 0.0, 21)
i_q = np.linspace(0.0, 200.0, 21)  # the half plane is enough: psi_d is even and psi_q odd in i_q
grid_d, grid_q = np.meshgrid(i_d, i_q, indexing="ij")

# Both linkages are derivatives of one co-energy, as those of every machine are.
shared = 1.0 + (grid_q / 400.0) ** 2
psi_d = 0.09 + 0.30e-3 * grid_d / shared
psi_q = 0.12 * np.tanh(grid_q / 150.0) - 0.15e-3 * grid_d**2 * (2.0 * grid_q / 400.0**2) / shared**2

# %% [markdown]
# ## The machine, and what it does at 300 V
#
# `scaling` and `axes` say in which convention the arrays are; peak values with d
# along the magnets are usual.

# %%
flux_map = dqforge.make_flux_map(i_d, i_q, psi_d, psi_q, scaling="peak", axes="magnet-d")
machine = dqforge.SaturatedMachine(
    pole_pairs=4, r_s=0.015, flux_map=flux_map, i_max=180.0, omega_m_max=800.0
)

torque = np.linspace(0.0, 80.0, 5)
points = dqforge.operating_points(
    machine, torque[:, None], np.array([100.0, 600.0])[None, :], v_dc=300.0
)
print("i_d at 100 rad/s:", np.round(points.i_d[:, 0], 2))
print("i_d at 600 rad/s:", np.round(points.i_d[:, 1], 2))
print("within reach:", points.reached.tolist())

# %% [markdown]
# ## Efficiency map
#
# A machine alone has no losses but those of its winding; a design adds inverter, control and
# everything that a design file may hold, by the same keys (docs/reference/inputs.md), as numbers
# in SI units.

# %%
design = dqforge.make_design(
    machine,
    v_dc=300.0,
    f_sw=10e3,
    name="Machine from arrays",
    prefix="bench",
    inverter={"dead_time": 1e-6},
    fit={"degree": 4, "segments": 2, "max_torque": 80.0},
)
chart = dqforge.operating_map(design, torques=25, speeds=30)
chart.plot("efficiency.svg")

# %% [markdown]
# ## The header for the firmware
#
# `verify` solves the design again, compiles the C as C99 and as C++11,
# and compares every bit with the model.

# %%
emission = dqforge.emit(design, "out")
print(", ".join(emission.files))
proof = dqforge.verify("out")
print(
    f"{proof.compared} results equal the model bit for bit, compiled as "
    f"{' and '.join(proof.languages)}"
)
