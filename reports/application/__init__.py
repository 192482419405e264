"""The program around the emitted functions: its C, its settings in words, and the report."""
