"""PWM by current feedback: regulators that switch the bridge, and the rules that are emitted."""
