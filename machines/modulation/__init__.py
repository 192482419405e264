"""Modulators: zero sequence, clamping, ripple, dead time and range."""
