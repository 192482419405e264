"""Machines in phase quantities, with any back-EMF, and their frames."""
