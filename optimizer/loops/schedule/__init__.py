"""Gains over the current: what is scheduled, and the forms that the firmware evaluates."""
