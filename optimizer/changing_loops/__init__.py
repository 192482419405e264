"""Current loops whose inductance changes with the current: one Lyapunov function for all of it."""
