"""Schemes of the general heavy top."""
