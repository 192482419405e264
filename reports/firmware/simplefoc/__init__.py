"""SimpleFOC's motor: a header that sets its members, sketches, and lines of the Commander."""
