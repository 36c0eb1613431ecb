"""What a command does: run, compare."""
