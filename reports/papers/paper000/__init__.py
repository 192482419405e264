"""Paper 000 (polynomials of the MTPA, discontinuous modulation) recomputed."""
