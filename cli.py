"""Command line of dqforge."""
