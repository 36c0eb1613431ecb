"""Random initial states and parameters of the rows of a sweep, with a seed for each row.

The seed of a row is the SHA-256 of the sweep's seed, the row's ``sample``, and the row's own top and initial state as
they are before the draw. It does not depend on the number of rows or on their order, so adding rows changes no other
row; and rows that differ in the scheme, in h or in N start from equal states, so schemes are compared on the same
motions.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from topcli.config.document import describe
from topcli.config.ensemble import Draw, Random, first_drawn
from topcli.config.members import ABSOLUTE, read_draw
from topcli.config.problems import Problems, unknown_key, validate
from topcli.config.sweep.values import Spread, read_spread
from topcli.contracts import Top


@dataclass(frozen=True)
class Drawer:
    """Rules to draw the vectors and parameters of a row; ``free`` are vectors that need no value in ``initial``."""

    seed: int
    draws: tuple[Draw, ...]
    spreads: tuple[Spread, ...]
    free: dict[str, list[float]]

    def parameters(self, seed: int, sample: int, source: str) -> dict[str, float]:
        """Drawn parameters of the top of a row that is described by ``source``."""
        return {
            one.name: one.value(
                np.random.Generator(np.random.PCG64(row_seed(seed, sample, f"{one.name}{source}"))).random()
            )
            for one in self.spreads
        }

    def state(self, top: Top, centre: Sequence[float], seed: int, sample: int, source: str) -> tuple[float, ...] | None:
        """Initial state of a row that is described by ``source``; None if no state has the wanted energy."""
        found = first_drawn(top, np.array(centre), self.draws, row_seed(seed, sample, source))
        return None if found is None else tuple(found.tolist())


def row_seed(seed: int, sample: int, source: str) -> int:
    """Seed of a row, a number of 63 bits."""
    digest = hashlib.sha256(f"{seed},{sample},{source}".encode()).digest()
    return int.from_bytes(digest[:8], "big") >> 1


def read_drawer(raw: object, cls: type[Top], top: Top, problems: Problems) -> Drawer | None:
    """Return the rules of the section ``random`` for tops of class ``cls``; None if they are wrong."""
    parameters = [f"top.{name}" for name in cls.model_fields]
    example = "random: {count: 100, " + ", ".join(f"{name}: {{near: 0.1}}" for name in cls.vectors) + "}"
    if not isinstance(raw, dict):
        problems.add(("random",), f"must be a section, not {describe(raw)}; for example {example}")
        return None
    fields = list(Random.model_fields)
    flat = dict(raw)
    if isinstance(inner := flat.pop("top", None), dict):
        flat |= {f"top.{name}": value for name, value in inner.items()}
    for key in flat:
        if key not in (*fields, *cls.vectors, *parameters):
            problems.add(("random", key), unknown_key(key, [*fields, *cls.vectors, *parameters]))
    given = {key: flat[key] for key in fields if key in flat}
    spec = validate(Random, {"count": 1, **given}, ("random",), problems)
    draws = [read_draw(flat[key], cls, top, ("random", key), problems) for key in cls.vectors if key in flat]
    spreads = [
        read_spread(flat[key], key.removeprefix("top."), ("random", key), problems) for key in parameters if key in flat
    ]
    if not draws and not spreads and not problems.messages:
        problems.add(("random",), f"nothing is random; for example {example}")
    if spec is None or problems.messages:
        return None
    chosen = tuple(draw for draw in draws if draw is not None)
    free = {draw.vector: [0.0, 0.0, 1.0] for draw in chosen if draw.kind in ABSOLUTE}
    return Drawer(spec.seed, chosen, tuple(one for one in spreads if one is not None), free)
