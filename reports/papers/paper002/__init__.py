"""Paper 002 (phase currents of machines with any back-EMF) recomputed."""
