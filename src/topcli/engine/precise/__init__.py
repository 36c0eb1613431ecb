"""Runs in arithmetic of any precision: the step functions of the schemes, copied for other numbers, interpreted."""
