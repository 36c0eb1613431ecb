"""Plain data whose numbers and words are all different."""

from __future__ import annotations

import random
from collections.abc import Collection
from typing import Any


def distinct(data: Any, seed: int, keep: Collection[str] = (), key: str = "") -> Any:
    """The same plain data with a number of its own in each place, so that no two cells look alike.

    Numbers under the keys ``keep`` stay. Integers become integers.
    """
    random_numbers = random.Random(seed)

    def walk(value: Any, key: str) -> Any:
        if isinstance(value, dict):
            return {name: walk(inner, name) for name, inner in value.items()}
        if isinstance(value, list):
            return [walk(inner, key) for inner in value]
        if key in keep or isinstance(value, bool) or not isinstance(value, int | float):
            return value
        size = 10.0 ** random_numbers.uniform(0.5, 4.5)
        return random_numbers.randrange(10, 10**6) if isinstance(value, int) else size

    return walk(data, key)


def named_differently(data: Any, keys: Collection[str]) -> Any:
    """The same plain data with a number of its own behind each word under one of the ``keys``."""
    count = iter(range(10**6))

    def walk(value: Any, key: str) -> Any:
        if isinstance(value, dict):
            return {name: walk(inner, name) for name, inner in value.items()}
        if isinstance(value, list):
            return [walk(inner, key) for inner in value]
        return f"{value}-{next(count)}" if key in keys and isinstance(value, str) else value

    return walk(data, "")
