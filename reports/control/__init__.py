"""Control functions as C, and their models."""
