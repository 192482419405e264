"""A fixed header on machines as they are made: torque, losses and margins of its loops."""
