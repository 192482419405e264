"""What stands around the content of a page: its scripts and their policy, the files beside it."""
