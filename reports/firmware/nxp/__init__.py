"""Configurations of NXP's MCAT: headers written, read, edited in place."""
