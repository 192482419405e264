"""Machines and errors as the methods of observing the position take them."""
