"""What is measured on states: invariants and drift, order, reversal, swings, errors."""
