"""Schemes and closed-form solutions for the Lagrange top."""
