"""The command line, and the Python functions and reports of runs and sweeps."""
