"""The speed from the edges of an encoder, as the firmware measures it."""
