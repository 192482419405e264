"""Paper 002, a thesis on control with frames that follow the back-EMF: printed beside found."""
