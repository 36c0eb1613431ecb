"""Methods generated from the field of a top: its exact polynomial, and implicit steps as straight-line code."""
