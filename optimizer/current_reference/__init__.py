"""Current references over torque: their form, fit and choice."""
