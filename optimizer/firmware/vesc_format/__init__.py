"""What the values of a VESC motor configuration mean, and what they cannot hold."""
