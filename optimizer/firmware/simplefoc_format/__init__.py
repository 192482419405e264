"""What the members of SimpleFOC's motor mean, and what they cannot hold."""
