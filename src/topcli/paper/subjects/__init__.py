"""The claims, grouped by the sections of the paper."""
