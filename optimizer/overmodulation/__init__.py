"""What overmodulation gives a drive, and what it costs."""
