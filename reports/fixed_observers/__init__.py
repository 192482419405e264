"""Position observers in fixed point: C code, evidence, the way back."""
