"""A module per firmware: the structure of its loops, its own rule for gains, what it can hold."""
