"""A ledger of the paper's checkable claims, each decided by an experiment.

``claim`` defines an entry, ``kinds`` the checks, ``subjects`` the entries, ``printed`` the paper's equations.
``decide`` carries the experiments out; only afterwards are the verdicts compared with those of ``recorded``.
"""
