"""Runs the rows of a study: in this process, on local processes, on a cluster that there is."""
