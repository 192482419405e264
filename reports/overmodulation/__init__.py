"""Overmodulation as tables, JSON, HTML and a figure."""
