"""Schemes that step every top."""
