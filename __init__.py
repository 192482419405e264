"""dqforge: controller coefficients, loss budgets and checked C headers
for permanent-magnet drives.
"""

__version__ = "0.1.0"
