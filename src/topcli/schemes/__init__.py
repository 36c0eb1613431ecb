"""Time discretizations, a file for each method or family of methods, and their registry."""
