"""Current regulators that switch the bridge themselves, beyond those that compare leg by leg."""
