"""HTML pages of stored results."""
