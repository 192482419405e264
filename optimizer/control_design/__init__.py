"""Gains of a whole drive: loops and observers judged together."""
