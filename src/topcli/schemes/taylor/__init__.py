"""Taylor series of high order: scheme, recurrences, generation of machine code."""
