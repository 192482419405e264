"""Control functions for machines with any back-EMF on any topology: C, model, tables."""
