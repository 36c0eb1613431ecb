"""Sweeps: rows that run in batches, a store of finished rows, from which an unfinished sweep continues, and tables."""
