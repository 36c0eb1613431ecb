"""Claims (checkable statements) of the paper, each of which an experiment tests.

``claims.yaml`` lists them, ``formulas`` are the paper's equations, ``checks`` the experiments, and ``claims`` compares
their verdicts with the recorded ones.
"""
