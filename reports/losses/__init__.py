"""Losses as tables, JSON, HTML and figures."""
