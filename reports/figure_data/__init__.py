"""The data of a figure, read from what is drawn in it."""
