"""Gains chosen within the structure of a firmware, over the box of the tolerances."""
