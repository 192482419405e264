"""Many machines at once: their least-loss currents, limits and current references as columns."""
