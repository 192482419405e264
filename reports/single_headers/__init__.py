"""Headers of single functions beside the main one: as C, tables, JSON and words."""
