"""The field-weakening reference as tables, JSON, figures and C."""
