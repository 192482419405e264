"""Currents of least loss within the limits."""
