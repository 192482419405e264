"""Paper 002 as its definitions have it: frames, equations of chapter 4, currents of chapter 6."""
