"""Six-step drives: blocks of 120 degrees commutated by the voltage of the phase that floats."""
