"""Scalar functions on floats: compiled by the engine, runnable as plain Python."""
