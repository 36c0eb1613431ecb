"""Schemes and closed-form solutions for the Euler top."""
