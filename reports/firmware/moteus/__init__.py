"""Configurations of moteus: lines of its own console."""
