"""Folders that are written: whole or not at all, with their hashes, and computed again."""
