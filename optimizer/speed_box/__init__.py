"""The speed loop, proven stable for every drive of the tolerance box."""
