"""Tables as a reader sees them: their cells, and whether a cell shows a number that is stored."""

from __future__ import annotations

import itertools
import random
import re
from collections.abc import Collection
from typing import Any

NUMBER = re.compile(r"[-+]?\d+(?:\.(\d+))?(?:[eE]([-+]?\d+))?(?![\w.])")


def cells_of(line: str) -> list[str]:
    """Cells of a printed line: two or more spaces separate them."""
    return re.split(r" {2,}", line.strip())


def cells_under(header: str, line: str) -> list[str]:
    """Cells of a line under the names of a header, in a table of left-aligned columns where a cell may be empty."""
    starts = [0, *(match.end() for match in re.finditer(r" {2,}", header.rstrip())), len(line)]
    return [line[start:end].strip() for start, end in itertools.pairwise(starts)]


def field(row: Any, path: str) -> Any:
    """Field of a row at a dotted path; None below a None."""
    for key in path.split("."):
        row = row if row is None else row[int(key) if isinstance(row, list) else key]
    return row


def shows(cell: str, *values: Any) -> bool:
    """True if the cell shows just these values, each number to its last digit and to two digits at least.

    A string is shown as it is, also behind numbers, and None as a dash. The numbers of a cell are read from its text
    and never formatted by the product's own functions.
    """
    if len(values) == 1 and isinstance(values[0], str):
        return cell == values[0]
    if len(values) == 1 and values[0] is None:
        return cell == "–"
    *values, unit = values if isinstance(values[-1], str) else (*values, "")
    found = list(NUMBER.finditer(cell.removesuffix(f" {unit}")))
    return (
        cell.endswith(unit)
        and len(found) == len(values)
        and all(_rounds(*pair) for pair in zip(found, values, strict=True))
    )


def _rounds(found: re.Match[str], value: float) -> bool:
    decimals, exponent = len(found[1] or ""), int(found[2] or 0)
    if isinstance(value, int):
        return float(found[0]) == value
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


_OUTCOMES = {
    "hk pole": ("held", None, "ok"),
    "hk delone": ("degraded", None, "ok"),
    "hk huge": ("broke", 17, "limit"),
    "hk rest": ("not tried", None, "ok"),
    "rk4 pole": ("broke", 40, "unexplained"),
    "rk4 delone": ("held", None, "outlived limit"),
    "rk4 huge": ("degraded", 3, "ok"),
    "rk4 rest": ("held", None, "ok"),
}
"""Outcome, step and verdict of each trial, all different within a scheme."""
STRESS_TRIALS: dict[str, Any] = {
    "trials": [
        {"scheme": name.split()[0], "top": "kowalevski", "case": name.split()[1], "why": f"why {name}"}
        | dict(zip(("outcome", "step", "verdict"), found, strict=True))
        for name, found in _OUTCOMES.items()
    ],
    "cases": [
        {"case": case, "top": "kowalevski", "question": f"{case}?"} for case in ("pole", "delone", "huge", "rest")
    ],
    "outcomes": {"held": 3, "degraded": 2, "broke": 2, "not tried": 1},
}
"""A study of two schemes in four hard cases."""
