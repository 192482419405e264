"""Outputs of a variant by name, and the steps that make them: one design at a time, or many."""
