"""Observers as tables, JSON, HTML and C."""
