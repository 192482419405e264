"""What is decided: operating points, polynomials for firmware, gains and loss budgets."""
