"""Schemes and closed forms of the Euler top."""
