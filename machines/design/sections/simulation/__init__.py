"""The section ``simulation``: its keys, and the scenario that they make."""
