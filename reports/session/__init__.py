"""What an engineer asks in Python, in SI numbers and arrays, and the results with their arrays."""
