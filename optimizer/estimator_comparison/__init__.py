"""Estimators of the position and start-ups compared: where each errs, holds and locks."""
