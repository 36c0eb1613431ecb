"""Schemes for the general heavy top."""
