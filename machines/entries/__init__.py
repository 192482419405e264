"""Single entries of a design file: quantities, names, deviations."""
