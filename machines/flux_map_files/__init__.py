"""Layouts of flux-map files, and what their arrays mean."""
