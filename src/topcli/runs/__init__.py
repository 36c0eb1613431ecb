"""Runs: plans, computation, recording and report."""
