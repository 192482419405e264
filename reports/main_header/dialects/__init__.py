"""Dialects of the main header, a folder each."""
