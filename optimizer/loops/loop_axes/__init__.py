"""Gains and margins of the loops of many machines at once."""
