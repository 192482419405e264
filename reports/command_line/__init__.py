"""What the command line has beside its commands: flags, designs by name, showing an answer, exit codes."""
