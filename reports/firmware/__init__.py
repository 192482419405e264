"""Configuration files of other firmware: written, read back, explained; a folder per firmware."""
