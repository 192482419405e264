"""The section ``machine``: its keys, and the models that they make."""
