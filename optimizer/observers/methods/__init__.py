"""One module for each method of observing the position."""
