"""The best modulator and carrier over torque and speed."""
