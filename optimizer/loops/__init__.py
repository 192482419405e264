"""Current and speed loops: gains, margins, tolerances."""
