"""One file per family of modulators; each lists its records in ``MODULATORS``."""
