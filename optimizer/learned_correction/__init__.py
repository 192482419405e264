"""A clamped and monitored correction of the flux observer's steady angle error, learned from the
drives of the tolerance box: Takagi-Sugeno rules (neuro-fuzzy) or a small network (neural).
"""
