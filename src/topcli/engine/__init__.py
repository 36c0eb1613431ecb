"""Compilation of a scheme's step, with a cache, and the time loop that iterates it."""
