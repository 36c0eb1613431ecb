"""Schemes for every top."""
