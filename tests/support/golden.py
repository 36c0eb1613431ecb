"""Recorded results: plain data in ``tests/golden/data``. ``GOLDEN=write pytest`` records them again."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

DATA = Path(__file__).parents[1] / "golden" / "data"
WRITE = os.environ.get("GOLDEN") == "write"
AGAIN = "if the new results are right, GOLDEN=write records them"


def differences(old: Any, new: Any, rel: float, path: str = "") -> Iterator[str]:
    """Places at which plain data differ: floats by more than ``rel``, anything else at all."""
    if isinstance(old, dict) and isinstance(new, dict):
        for key in {**old, **new}:
            yield from differences(old.get(key, "(none)"), new.get(key, "(none)"), rel, f"{path}.{key}")
    elif isinstance(old, list) and isinstance(new, list) and len(old) == len(new):
        for i, pair in enumerate(zip(old, new, strict=True)):
            yield from differences(*pair, rel, f"{path}[{i}]")
    elif isinstance(old, float) and isinstance(new, float):
        if not (math.isclose(old, new, rel_tol=rel, abs_tol=1e-15 if rel else 0.0) or (old != old and new != new)):
            yield f"{path}: {old!r} -> {new!r}"
    elif old != new:
        yield f"{path}: {old!r} -> {new!r}"


def check(name: str, data: Any, rel: float = 0.0) -> None:
    """Fail if the data differ from the recorded ones."""
    path, data = DATA / f"{name}.json", json.loads(json.dumps(data))
    if WRITE:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(data, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    assert path.exists(), f"{name}: nothing is recorded; {AGAIN}"
    changes = list(differences(json.loads(path.read_text(encoding="utf-8")), data, rel))
    assert not changes, "\n".join([f"{name}: {AGAIN}", *(change[:300] for change in changes[:20])])
