"""Current-feedback PWM: tables, JSON, figures, and what is emitted of a regulator."""
