"""From points to a flux map: checks, smoothing, symmetry and evidence."""
