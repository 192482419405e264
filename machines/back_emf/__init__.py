"""Measured back-EMF: from captures to harmonics of the flux linkage."""
