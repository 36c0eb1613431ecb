"""Taylor series of high order: the scheme, its recurrences, and their machine code."""
