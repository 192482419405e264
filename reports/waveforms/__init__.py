"""Phase currents as tables, JSON, HTML, figures and C."""
