"""Schemes for the Kowalevski top."""
