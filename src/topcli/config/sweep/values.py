"""Values of a key of a sweep: lists and ranges."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated, Any, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, create_model

from topcli.config.document import KeyPath, describe
from topcli.config.models import as_integer
from topcli.config.problems import Problems, validate
from topcli.tops import TOPS

MAX_ROWS = 10**7
INTEGER_KEYS = ("N", "output.every", "sample", "seed")
"""Keys whose values are whole numbers; those of a range are rounded."""

_strict = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)
_Count = Annotated[int, Field(ge=1, le=MAX_ROWS), BeforeValidator(as_integer)]
Range: Any = create_model(
    "Range",
    __config__=_strict,
    **{  # type: ignore[call-overload]
        "from": (float, Field(description="the first value")),
        "to": (float, Field(description="the last value")),
        "count": (_Count, Field(description="the number of values")),
        "spacing": (Literal["linear", "log"], Field(default="linear", description="linear or log")),
    },
)
"""Range of values, both ends included."""
Interval: Any = create_model(
    "Interval",
    __config__=_strict,
    **{  # type: ignore[call-overload]
        "from": (float, Field(description="the smallest value")),
        "to": (float, Field(description="the largest value")),
        "spacing": (Literal["linear", "log"], Field(default="linear", description="linear or log")),
    },
)
"""Interval from which a parameter of the top is drawn."""


def is_range(raw: object) -> bool:
    """True if ``raw`` is meant as a range."""
    return isinstance(raw, dict) and bool({"from", "to", "count", "spacing"} & raw.keys())


def between(first: float, last: float, share: float, log: bool) -> float:
    """Value at ``share`` (0 to 1) of the way from ``first`` to ``last``, rounded to 15 digits.

    The rounding makes the values independent of the machine's logarithms, and 0.001 of 0.0010000000000000002.
    """
    if log:
        value = math.copysign(math.exp(math.log(abs(first)) * (1.0 - share) + math.log(abs(last)) * share), first)
    else:
        value = first * (1.0 - share) + last * share
    return float(f"{value:.15g}")


def bounds_fault(first: float, last: float, log: bool) -> str:
    """Reason why values cannot be spaced by ``between``; empty if they can."""
    if log and not first * last > 0.0:
        return f"from and to must be both positive or both negative for spacing: log, not {first!r} and {last!r}"
    return ""


def read_values(
    raw: object, key: str, path: KeyPath, problems: Problems, unique: bool = True
) -> tuple[Sequence[Any], bool] | None:
    """Return the values of a ``key`` and True for a logarithmic range; None if they are wrong."""
    if is_range(raw):
        assert isinstance(raw, dict)
        return _range(raw, key, path, problems)
    example = "[0.1, 0.2] or {from: 0.1, to: 1, count: 10}"
    if not isinstance(raw, list):
        problems.add(path, f"must be a list of values or a range, not {describe(raw)}; for example {example}")
        return None
    if not raw:
        problems.add(path, f"has no values, so the sweep would have no rows; for example {example}")
        return None
    vectors = {name for cls in TOPS.values() for name in cls.vectors}
    if key.removeprefix("initial.") in vectors and not any(isinstance(value, list) for value in raw):
        problems.add(path, f"must be a list of vectors, each a list of numbers; for a single one write [{raw}]")
        return None
    seen: set[str] = set()
    for value in raw if unique else ():
        text = repr(value)
        if text in seen:
            problems.add(path, f"holds {describe(value) if not isinstance(value, list) else text} twice")
            return None
        seen.add(text)
    return raw, False


def _ends(model: Any, raw: dict[str, Any], path: KeyPath, problems: Problems) -> tuple[Any, float, float, bool] | None:
    """Section ``raw`` as a ``model``, its ends, and True for logarithmic spacing; None if it is wrong."""
    found = validate(model, raw, path, problems)
    if found is None:
        return None
    first, last, log = getattr(found, "from"), found.to, found.spacing == "log"
    if fault := bounds_fault(first, last, log):
        problems.add(path, fault)
        return None
    return found, first, last, log


def _range(raw: dict[str, Any], key: str, path: KeyPath, problems: Problems) -> tuple[Sequence[Any], bool] | None:
    first, last = raw.get("from"), raw.get("to")
    if "count" not in raw and key in ("sample", "seed") and isinstance(first, int) and isinstance(last, int):
        raw = {**raw, "count": max(1, last - first + 1)}
    ends = _ends(Range, raw, path, problems)
    if ends is None:
        return None
    found, first, last, log = ends
    if found.count == 1:
        values = [first]
    elif first == last:
        problems.add(path, f"from and to are both {first!r}; a range of {found.count} values needs two ends")
        return None
    else:
        inner = (between(first, last, i / (found.count - 1), log) for i in range(1, found.count - 1))
        values = [first, *inner, last]
    if key in INTEGER_KEYS:
        return list(dict.fromkeys(round(value) for value in values)), log
    return values, log


class Spread(BaseModel):
    """Distribution of a parameter of the top: uniform between ``first`` and ``last``, or in their logarithms."""

    model_config = ConfigDict(frozen=True)

    name: str
    first: float
    last: float
    log: bool

    def value(self, share: float) -> float:
        """Value at ``share``, a uniform number from 0 to 1."""
        return between(self.first, self.last, share, self.log)


def read_spread(raw: object, name: str, path: KeyPath, problems: Problems) -> Spread | None:
    """Return how the parameter ``name`` of the top is drawn; None if it is wrong."""
    if not isinstance(raw, dict):
        problems.add(path, f"must be an interval such as {{from: 1, to: 2}}, not {describe(raw)}")
        return None
    ends = _ends(Interval, raw, path, problems)
    if ends is None:
        return None
    _, first, last, log = ends
    return Spread(name=name, first=first, last=last, log=log)
