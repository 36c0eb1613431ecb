"""Linear equations in exact numbers, by elimination."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from typing import Any


def row_reduced(rows: Sequence[Sequence[Any]]) -> tuple[list[list[Any]], list[int]]:
    """Reduced row echelon form of a matrix of integers or fractions without its zero rows; columns of its pivots."""
    left, pivots = [[x * Fraction(1) for x in row] for row in rows], list[int]()
    for column in range(len(left[0])):
        done = len(pivots)
        row = next((k for k in range(done, len(left)) if left[k][column] != 0), None)
        if row is not None:
            pivot = left.pop(row)
            pivot = [x / pivot[column] for x in pivot]
            left = [[a - other[column] * b for a, b in zip(other, pivot, strict=True)] for other in left]
            left.insert(done, pivot)
            pivots.append(column)
    return left[: len(pivots)], pivots


def linear_solution(rows: Sequence[Sequence[Any]]) -> list[Any] | None:
    """Solution of n equations, each a row of n coefficients and its right-hand side; None if there is no single one."""
    left, pivots = row_reduced(rows)
    return [row[-1] for row in left] if pivots == list(range(len(rows))) else None
