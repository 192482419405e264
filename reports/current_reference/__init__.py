"""The current reference as text, tables, JSON, HTML, figures and C."""
