"""What differs from one operating system to the next, and what a machine has: compilers, locks of
folders, what lasts on the disk, encodings of a terminal.
"""
