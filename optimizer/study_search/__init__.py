"""A seeded search in place of a grid: generations of rows, each from the outcomes before it."""
