"""The choice of modulator as tables, JSON, HTML, figures and C."""
