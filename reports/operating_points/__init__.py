"""Operating points as tables, JSON, HTML and figures."""
