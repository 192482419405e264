"""Six-step drives: the emitted header, its model, the drive in the time domain, and what is said of
them.
"""
