"""What to flash: topologies and current controllers of a phase machine, side by side."""
