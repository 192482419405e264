"""Values of a design held against what drives usually have."""
