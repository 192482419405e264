"""Two designs or results side by side."""
