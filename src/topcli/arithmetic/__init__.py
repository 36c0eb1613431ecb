"""Arithmetic without physics: floats in, floats out, compiled by the engine and runnable as plain Python."""
