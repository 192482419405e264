"""The program around the emitted functions: which kind a design needs, and its settings."""
