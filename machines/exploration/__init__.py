"""A study: which keys of a design vary, how, and what is asked of each variant."""
