"""The closed loops of paper 002: circuits, controllers, and what the emitted C makes of them."""
