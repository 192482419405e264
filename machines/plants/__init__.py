"""Machines and drives over time."""
