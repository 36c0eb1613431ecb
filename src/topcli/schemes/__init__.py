"""Time discretizations, one package per top, and their registry."""
