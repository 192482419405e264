"""What the steps of emitted functions are written over, and how else they are read."""
