"""Parameters of Infineon's motor-ctrl-lib: assignments to its structure params."""
