"""An attack on topcli: mutated configs, damaged files, killed processes; ``python -m attack`` with tests/ on the path.

``mutations`` makes configs wrong and ``fuzz`` feeds them to the command, ``damage`` spoils files of runs and of the
machine-code cache, ``kills`` ends runs with SIGKILL. ``command`` calls the command line in a fork that is watched,
``judge`` says what must not be. Everything drawn at random follows from one seed, except the moments of the kills.
"""
