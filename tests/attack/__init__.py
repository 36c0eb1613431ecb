"""An attack on topcli: hostile files, damaged results, faults of the disk; ``python -m attack``, tests/ on the path.

``mutations`` makes configs and sweep files wrong and ``fuzz`` feeds them to the command; ``series`` does so with files
of other programs. ``damage`` and ``sweeps`` spoil what is stored, ``pages`` puts markup into it, and ``kills``
lets faults of ``faults`` fall on the n-th operation on the disk. ``command`` calls the command line in a fork that is
watched, ``judge`` says what must not be. Everything drawn at random follows from one seed.
"""
