"""What every emitted C file is made of."""
