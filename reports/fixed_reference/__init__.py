"""Current references in integers as C, data, tables and words."""
