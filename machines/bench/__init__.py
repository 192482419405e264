"""Bench files: the runs of a bench, their logs, and what is known of the machine."""
