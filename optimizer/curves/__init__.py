"""Piecewise polynomials and their best fits."""
