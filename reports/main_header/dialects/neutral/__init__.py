"""The names of dqforge."""
