"""What comes out: C headers and their verification, figures, the HTML
report and the papers' tables.
"""
