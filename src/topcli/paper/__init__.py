"""Ledger (list) of the paper's checkable claims, each of which an experiment tests.

``claim`` defines an entry, ``kinds`` the checks, ``subjects`` the entries, ``printed`` the paper's equations.
``decide`` carries the experiments out; only afterwards are the verdicts compared with those of ``recorded``.
"""
