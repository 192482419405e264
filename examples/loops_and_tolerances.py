# %% [markdown]
# # Loops that hold over tolerances
#
# Gains are tuned for the sampled loop with its delay, and judged at every corner of the tolerances
# of R, L, psi and J. The question here: which bandwidth of the current loops still keeps 30 degrees
# of phase margin at the worst corner?

# %%
import numpy as np

import dqforge

machine = dqforge.LinearMachine(
    pole_pairs=3,
    r_s=2.35,
    l_d=1.61e-3,
    l_q=1.74e-3,
    psi_pm=0.06,
    i_max=6.4,
    inertia=200e-6,
    friction=40e-6,
)
tolerances = {"r_s": 0.3, "l_d": 0.2, "l_q": 0.2, "psi_pm": 0.05, "inertia": 0.2}


def tuned(bandwidth: float) -> dqforge.Tuning:
    """Gains for a bandwidth of the current loops in rad/s."""
    control = {
        "current_loop": {"method": "bandwidth", "bandwidth": bandwidth},
        "speed_loop": {"method": "symmetrical-optimum", "ratio": 10},
        "tolerances": tolerances,
    }
    return dqforge.tune(dqforge.make_design(machine, v_dc=180.0, f_sw=10e3, control=control))


# %% [markdown]
# ## Gains and margins
#
# `robust` holds the worst corner of each loop.

# %%
for hertz in (300.0, 500.0, 700.0):
    found = tuned(2.0 * np.pi * hertz)
    loop, robust = found.gains.i_q, found.gains.robust
    assert robust is not None
    worst = robust.i_q.phase_margin
    margins = (
        f"{np.degrees(loop.phase_margin):.1f} deg, at the worst corner "
        f"{np.degrees(worst.value):.1f} deg"
    )
    print(f"{hertz:4.0f} Hz: kp {loop.kp:6.3f} V/A, phase margin {margins} ({worst.at})")

# %% [markdown]
# ## What is refused
#
# A set that does not hold at a corner is no result: the message names the corner and
# the bandwidth that would do.

# %%
try:
    tuned(2.0 * np.pi * 900.0)
except dqforge.NoSolutionError as error:
    print(error)

tuned(2.0 * np.pi * 500.0).plot("loops.svg")
