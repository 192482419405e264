"""Drives drawn at random, by which methods that hold for any drive are tried."""
