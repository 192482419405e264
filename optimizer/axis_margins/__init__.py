"""Margins of one axis's current loop, proven for every drive of the tolerance box."""
