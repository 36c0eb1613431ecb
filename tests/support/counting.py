"""A small computation with rows, a checkpoint after every few of them, and a report, for tests of the store."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np

from topcli.store.growing_table import GrowingTable
from topcli.store.identity import Identity
from topcli.store.result_folder import ResultFolder

NAME = "odd [name] 'ü' 100%"
CHUNK = 16
N = 70


def counted(h: float = 0.1, code: str = "c" * 64, form: str = "parquet") -> Identity:
    """Identity of the computation with a step ``h``."""
    config = {"name": NAME, "h": h, "scheme": {"name": "counting"}, "output": {"format": form}}
    return Identity(config, hashlib.sha256(str(h).encode()).hexdigest(), code)


COUNTED = counted()


def compute(
    out: Path,
    identity: Identity = COUNTED,
    *,
    every: int = 1,
    force: bool = False,
    on_chunk: Callable[[int], bool | None] = lambda n: None,
) -> str:
    """Compute N steps into ``out``, until ``on_chunk`` returns True; return "ran", "continued" or "up to date"."""
    with ResultFolder.claim(out / NAME, identity, force=force) as folder:
        if folder.complete:
            return "up to date"
        state = folder.checkpoint()
        n, y, total = int(state.get("n", 0)), float(state.get("y", 0.3)), float(state.get("total", 0.0))
        stopped = False
        form = identity.config["output"]["format"]
        with GrowingTable(folder.working, "series", {"topcli.digest": identity.digest}, form) as table:
            if state:
                table.restore(state)
            while n < N and not stopped:
                rows, end = [], min(n + CHUNK, N)
                while n < end:
                    n, y = n + 1, 4.0 * y * (1.0 - y) * (1.0 - identity.config["h"])
                    total += y
                    rows += [(n, y)] if n % every == 0 else []
                numbers, values = zip(*rows, strict=True)
                table.add({"n": np.array(numbers), "y": np.array(values)})
                stopped = on_chunk(n) is True
                folder.save({"n": n, "y": y, "total": total, **table.commit()})
            series = table.finish(["n", "y"], {})
        outcome = "interrupted" if stopped else "completed"
        report = json.dumps({"outcome": outcome, "total": total})
        folder.finish({"outcome": outcome, "series": series.name}, {"report.json": report}, [series])
        return "continued" if state else "ran"


def tree(folder: Path) -> dict[str, bytes]:
    """Every file below a folder by its path, with its content."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}
