"""The command line beside its commands: flags, designs by name, showing answers, exit codes."""
