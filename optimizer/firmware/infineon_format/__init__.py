"""What the parameters of Infineon's motor-ctrl-lib mean, and what they cannot hold."""
