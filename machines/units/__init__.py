"""Units and quantities as they are written."""
