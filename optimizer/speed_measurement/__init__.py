"""The speed from the edges of an encoder: resolution and delay."""
