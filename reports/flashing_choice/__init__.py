"""What to flash: the comparison as tables and plain data, and its rows in the simulation."""
