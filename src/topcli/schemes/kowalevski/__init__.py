"""Schemes of the Kowalevski top."""
