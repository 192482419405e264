"""Operating points where the data of a flux map end."""
