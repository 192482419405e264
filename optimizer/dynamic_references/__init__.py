"""Current references that move: slopes of torque and current, and field weakening by voltage."""
