"""Phase currents of constant torque."""
