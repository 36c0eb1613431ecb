"""Compile a scheme's step (with a content-keyed cache) and iterate it: the one time loop."""
