"""Schemes and closed forms of the Lagrange top."""
