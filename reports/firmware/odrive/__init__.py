"""Configurations of ODrive 0.5: the JSON of odrivetool."""
