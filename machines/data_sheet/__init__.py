"""A design from what a data sheet says: the values that are asked for, judged and written down."""
