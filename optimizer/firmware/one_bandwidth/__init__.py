"""Firmware that works out its current gains from one bandwidth: keys, choice, prices."""
