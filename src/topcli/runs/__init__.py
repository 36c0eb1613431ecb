"""Runs: identity, plans, computation, recording and report."""
