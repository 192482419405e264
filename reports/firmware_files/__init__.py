"""Configurations of other firmware: files recognised and written, explained, made designs."""
