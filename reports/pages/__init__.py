"""What pages, tables and figures have in common."""
