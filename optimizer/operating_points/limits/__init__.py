"""What bounds the operating points: current, voltage and the data of a flux map."""
