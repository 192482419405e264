"""The header of a folder that a run wrote, read back to meet other machines."""
