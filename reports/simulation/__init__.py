"""The emitted code in the loop with a compiled plant."""
