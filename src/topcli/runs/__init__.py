"""The life of a run: what is computed, what is recorded, what is reported."""
