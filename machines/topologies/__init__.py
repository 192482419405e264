"""Ways to feed the three phases: legs, neutral, voltages that can be made, duty cycles."""
