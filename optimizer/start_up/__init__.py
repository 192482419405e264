"""From standstill to speed without an encoder: what a start needs, and what it can lift."""
