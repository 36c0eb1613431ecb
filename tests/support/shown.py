"""Tables as a reader sees them: their cells, and whether a cell shows a number that is stored."""

from __future__ import annotations

import itertools
import random
import re
from collections.abc import Callable, Collection
from typing import Any

NUMBER = re.compile(r"[-+]?\d+(?:\.(\d+))?(?:[eE]([-+]?\d+))?(?![\w.])")


def cells_of(line: str) -> list[str]:
    """Cells of a printed line: two or more spaces separate them."""
    return re.split(r" {2,}", line.strip())


def table_of(out: str, first: str) -> list[list[str]]:
    """Rows of the printed table whose header begins with ``first``, header included, down to an empty line."""
    lines = out.splitlines()
    start = next(i for i, line in enumerate(lines) if cells_of(line)[0] == first)
    end = next((i for i in range(start, len(lines)) if not lines[i].strip()), len(lines))
    return [cells_of(line) for line in lines[start:end]]


def cells_under(header: str, line: str) -> list[str]:
    """Cells of a line under the names of a header, in a table of left-aligned columns where a cell may be empty."""
    starts = [0, *(match.end() for match in re.finditer(r" {2,}", header.rstrip())), len(line)]
    return [line[start:end].strip() for start, end in itertools.pairwise(starts)]


def shows(cell: str, *values: Any, rounded: int | None = None) -> bool:
    """True if the cell shows just these values, each number to its last digit and to two digits at least.

    A string is shown as it is, None as a dash. The numbers of a cell are read from its text and never formatted by
    the product's own functions. A cell may be ``rounded`` to so few significant digits that zeros fill it up.
    """
    if len(values) == 1 and isinstance(values[0], str):
        return cell == values[0]
    if len(values) == 1 and values[0] is None:
        return cell == "–"
    found = list(NUMBER.finditer(cell))
    return len(found) == len(values) and all(_rounds(*pair, rounded) for pair in zip(found, values, strict=True))


def _rounds(found: re.Match[str], value: float, rounded: int | None) -> bool:
    decimals, exponent = len(found[1] or ""), int(found[2] or 0)
    if isinstance(value, int):
        return float(found[0]) == value
    if rounded is not None:
        return float(found[0]) == float(f"{value:.{rounded}g}")
    written = re.sub(r"\D", "", found[0].lower().partition("e")[0]).lstrip("0")
    short = float(f"{value:.2g}") == float(found[0])  # 5.0 shown as 5
    return abs(float(found[0]) - value) <= 0.501 * 10.0 ** (exponent - decimals) and (len(written) >= 2 or short)


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


def changed_result(change: Callable[[Any], Any], measure: Callable[..., Any]) -> Callable[..., Any]:
    """``measure`` called once; every call returns its changed result, so that a table and its JSON agree."""
    kept: list[Any] = []

    def call(*arguments: Any, **options: Any) -> Any:
        if not kept:
            kept.append(change(measure(*arguments, **options)))
        return kept[0]

    return call
