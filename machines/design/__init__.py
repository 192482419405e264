"""A design file: its sections, what they mean, and where each value comes from."""
