"""One module for each section of a design file: schema, reading and checks."""
