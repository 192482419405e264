"""A design in a browser on this machine: form, live answers, files (`dqforge serve`)."""
