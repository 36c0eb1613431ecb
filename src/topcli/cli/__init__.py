"""The command line: prints, exits, nothing else."""
