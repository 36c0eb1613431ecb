"""Sweeps: a plan of rows, which run in batches, and a journal from which an unfinished sweep continues."""
