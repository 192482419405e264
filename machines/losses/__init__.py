"""Losses of machine and bridge, and the temperatures that they cause."""
