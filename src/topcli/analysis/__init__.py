"""Measurements on recorded states: invariants and drift, order, reversal, swings, errors."""
