"""Schemes and closed-form solutions of the Euler and the Lagrange top."""
