"""Estimators and start-ups compared: tables, plain data, figures, what their C costs, the pair."""
