"""Current references over torque and voltage."""
