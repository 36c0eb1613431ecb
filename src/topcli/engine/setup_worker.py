"""Set-ups of closed forms in a process of its own, which answers each line of JSON with a line of JSON.

    python -m topcli.engine.setup_worker

A request ``{"class": [module, name], "y0", "p"}`` has the numbers in hexadecimal. It is answered with ``{"setup"}``:
the bytes in base64, or null if they cannot be computed.
"""

from __future__ import annotations

import json
import os
import sys
from base64 import b64encode
from importlib import import_module
from typing import Any

import numpy as np

from topcli.errors import TopcliError


def answer(request: dict[str, Any]) -> dict[str, str | None]:
    """Answer one request."""
    module, name = request["class"]
    if not module.startswith("topcli."):
        raise ValueError(f"{module} is no part of topcli")
    setup = getattr(import_module(module), name)()
    y0 = np.array([float.fromhex(text) for text in request["y0"]])
    try:
        data = setup.compute(y0, tuple(float.fromhex(text) for text in request["p"]))
    except (TopcliError, ArithmeticError):
        return {"setup": None}
    return {"setup": b64encode(data).decode()}


def main() -> None:
    """Answer the requests on stdin until it ends."""
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # what a library prints is no answer
    for line in sys.stdin:
        print(json.dumps(answer(json.loads(line))), file=answers, flush=True)


if __name__ == "__main__":
    main()
