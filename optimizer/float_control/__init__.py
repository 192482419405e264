"""Field-oriented control in single precision: the steps that are emitted."""
