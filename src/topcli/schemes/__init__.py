"""Time discretizations: one family a file, and the registry that lists them."""
