"""Emitted C compiled, run and compared, on the host and on emulated cores."""
