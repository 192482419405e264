"""Switching devices: their data, their files and their checks."""
