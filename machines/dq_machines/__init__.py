"""Machines in rotor coordinates, linear and saturated."""
