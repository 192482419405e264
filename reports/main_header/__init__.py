"""The main header of a design."""
