"""Estimators of the position that need more than voltage and current, or ask for a voltage of
their own, under one record.
"""
