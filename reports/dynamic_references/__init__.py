"""Slopes of the references and voltage feedback: words, tables and plain data."""
