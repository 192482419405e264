"""Starts from standstill tried by the hundred with the emitted C, and how often they succeed."""
