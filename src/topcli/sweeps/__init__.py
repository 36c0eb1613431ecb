"""Sweeps: a plan of many rows, evaluated in batches, with a journal from which every sweep resumes."""
