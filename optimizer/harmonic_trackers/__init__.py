"""Position from harmonics of the phase voltages that no current carries."""
