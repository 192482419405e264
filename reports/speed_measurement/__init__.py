"""The emitted measurement of the speed: header, model, tables."""
