"""Runs: decision, computation, recording and report."""
