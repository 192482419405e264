"""Loops as tables, JSON, HTML, figures and C."""
