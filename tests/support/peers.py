"""A peer for the benchmark, in a module that its process can import."""

from __future__ import annotations

import os
from typing import Any

import numpy as np


def start(experiment: Any, times: Any, fault: str) -> Any:
    """Peer whose states are off by the tolerance; it prints, and the ``fault`` happens at some tolerance."""
    print("noise")
    if fault == "import":
        raise ImportError("wants gold\nand more")

    def prepare(tol: float) -> Any:
        if fault == "raise" and tol < 0.2:
            raise ValueError("too small")
        if fault == "die" and tol < 0.4:
            os._exit(7)
        return lambda: np.tile(experiment.y0, (len(times), 1)) + tol

    return prepare
