"""Captures of the back-EMF, as tables, JSON and figures."""
