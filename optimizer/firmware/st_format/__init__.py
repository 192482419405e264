"""The numbers of ST's MCSDK: counts, integer gains, observer, table of currents."""
