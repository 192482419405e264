"""Files that a user names: text tables, arrays, YAML and XML with positions."""
