"""The start-up as an emitted state machine: its header, its model, and what is said of it."""
