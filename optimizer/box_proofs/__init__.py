"""Proofs that a loop is stable at every point of a box of parameters."""
