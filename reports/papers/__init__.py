"""Reproductions of the papers."""
