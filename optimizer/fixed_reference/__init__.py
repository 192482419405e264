"""Current references in integers for the integer control: torque, dc link and speed to currents."""
