"""Current-feedback PWM of a design: its numbers, what it does at points, and what it loses."""
