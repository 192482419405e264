"""Paper 001 (a bench with a fixed-point signal processor) recomputed."""
