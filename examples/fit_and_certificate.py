# %% [markdown]
# # How many segments does a current reference need?
#
# The firmware evaluates polynomials in the torque. More segments and higher degrees err less and
# cost more; the errors of the emitted arithmetic are found by sampling, and then proven for every
# torque.

# %%
import numpy as np

import dqforge

machine = dqforge.LinearMachine(
    pole_pairs=4, r_s=9.5e-3, l_d=350e-6, l_q=592e-6, psi_pm=0.1049, i_max=280.0
)


def design_with(degree: int, segments: int) -> dqforge.Design:
    """A design of this machine with one form of its current reference."""
    fit = {"form": "polynomial", "degree": degree, "segments": segments, "max_torque": 200.0}
    return dqforge.make_design(machine, v_dc=500.0, f_sw=20e3, prefix="drive", fit=fit)


# %% [markdown]
# ## Errors over degree and segments

# %%
print("degree  segments  torque error  loss penalty")
for degree in (2, 3, 4):
    for segments in (1, 2):
        errors = dqforge.fit(design_with(degree, segments)).errors
        row = f"{degree:6}  {segments:8}  {100 * errors.torque_relative:10.4f} %"
        print(f"{row}  {100 * errors.loss_relative:10.5f} %")

# %% [markdown]
# ## The cheapest that keeps a budget
#
# With a budget the form, the degree and the segments are searched for,
# in order of their cost on the core.

# %%
budget = {"torque_error": 1e-3, "loss_penalty": 1e-3}
chosen = dqforge.fit(dqforge.make_design(machine, v_dc=500.0, f_sw=20e3, fit=budget))
print(f"chosen: {chosen.form} after {len(chosen.trials)} trials")

# %% [markdown]
# ## Bounds for every torque
#
# What is proven is an upper bound, rounding included; it lies close above what sampling found.

# %%
proven = dqforge.certify(chosen)
assert proven.certificate is not None
print(f"torque error found  {100 * proven.errors.torque_relative:.5f} %")
print(f"torque error proven {100 * proven.certificate.torque_relative:.5f} %")

torque = np.linspace(-200.0, 200.0, 5)
i_d, i_q = proven.currents(torque)  # what the firmware computes, in single precision
print("i_d", i_d, "i_q", i_q)
proven.plot("fit.svg")
