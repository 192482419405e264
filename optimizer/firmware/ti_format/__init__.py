"""What the values of a motor block of TI's universal lab mean, and what they cannot hold."""
