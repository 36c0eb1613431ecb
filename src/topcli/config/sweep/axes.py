"""Axes of a sweep: the keys that vary and their values, from the sections grid, zip, include, exclude and random."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from topcli.config.document import KeyPath, describe
from topcli.config.problems import Problems
from topcli.config.sweep.keys import unknown_axis
from topcli.config.sweep.values import MAX_ROWS, is_range, read_values


@dataclass(frozen=True)
class Axis:
    """Values that vary together: for each of ``keys`` a column of equal length."""

    keys: tuple[str, ...]
    columns: tuple[Sequence[Any], ...]

    def __len__(self) -> int:
        return len(self.columns[0])


def check_exclusions(exclude: Iterable[Mapping[str, Any]], reader: AxisReader, problems: Problems) -> None:
    """Report exclusions that no row can match."""
    for index, one in enumerate(exclude):
        for key, value in one.items():
            values = reader.seen.get(key)
            if values is None:
                varied = ", ".join(reader.seen) or "none"
                problems.add(
                    ("exclude", index, key), f"is not varied by grid or zip, so nothing is excluded; varied: {varied}"
                )
            elif value not in values:
                shown = ", ".join(map(repr, list(values)[:5])) + (", ..." if len(values) > 5 else "")
                problems.add(("exclude", index, key), f"no row has the value {value!r}; values: {shown}")


def check_drawn(random: object, keys: Iterable[str], problems: Problems) -> None:
    """Report vectors and parameters that are drawn and varied as well; the centre of ``near`` may vary."""
    drawn = random if isinstance(random, dict) else {}
    for name, rule in drawn.items():
        if name in ("count", "seed") or (isinstance(rule, dict) and "near" in rule):
            continue
        for key in keys:
            vector = key.removeprefix("initial.")
            if key == name or (vector != key and name in (vector, vector.rstrip("0123456789"))):
                problems.add(("random", name), f"is drawn in every row, and {key} is varied; keep one of them")


class AxisReader:
    """The axes read so far, ``seen`` their keys with all values, and the mistakes."""

    def __init__(self, problems: Problems, known: Sequence[str]) -> None:
        self.problems, self.known = problems, list(known)
        self.axes: list[Axis] = []
        self.seen: dict[str, Sequence[Any]] = {}
        self.log: list[str] = []
        self.ranged: set[str] = set()

    def _section(self, raw: object, path: KeyPath, example: str) -> dict[str, Any]:
        if isinstance(raw, dict) and raw:
            return raw
        if raw is not None:
            given = "an empty one" if raw == {} else describe(raw)
            self.problems.add(path, f"must be a section of keys and their values, not {given}; for example {example}")
        return {}

    def _known(self, key: str, path: KeyPath) -> bool:
        if key in self.known:
            return True
        self.problems.add(path, unknown_axis(key, self.known))
        return False

    def _values(self, key: str, raw: object, path: KeyPath) -> Sequence[Any] | None:
        """Values of a key that no axis has yet."""
        if not self._known(key, path):
            return None
        if key in self.seen:
            self.problems.add(path, "is varied twice; keep one of them")
            return None
        found = read_values(raw, key, path, self.problems, unique=path[0] == "grid")
        if found is None:
            return None
        values, log = found
        self.seen[key] = values
        if log:
            self.log.append(key)
        if is_range(raw):
            self.ranged.add(key)
        return values

    def random(self, raw: object) -> None:
        """Add the axis ``sample`` of the random draws."""
        if isinstance(raw, dict) and isinstance(count := raw.get("count", 1), int) and 1 <= count <= MAX_ROWS:
            self.seen["sample"] = range(1, count + 1)

    def grid(self, raw: object) -> None:
        """Add one axis for each key of ``grid``, and last that of the random draws."""
        sampled = self.seen.pop("sample", None)
        for key, values in self._section(raw, ("grid",), "grid: {h: [0.1, 0.2]}").items():
            found = self._values(key, values, ("grid", key))
            if found is not None:
                self.axes.append(Axis((key,), (found,)))
        if sampled is not None and "sample" not in self.seen:
            self.seen["sample"] = sampled
            self.axes.append(Axis(("sample",), (sampled,)))

    def zip(self, raw: object) -> None:
        """Add one axis for each section of lists that go together."""
        sections = raw if isinstance(raw, list) and raw else [raw]
        for index, section in enumerate(sections):
            path: KeyPath = ("zip", index) if isinstance(raw, list) else ("zip",)
            lists = {
                key: self._values(key, values, (*path, key))
                for key, values in self._section(section, path, "zip: {h: [0.1, 0.2], N: [200, 100]}").items()
            }
            lengths = {key: len(values) for key, values in lists.items() if values is not None}
            if len(set(lengths.values())) > 1:
                listed = ", ".join(f"{key} has {length}" for key, length in lengths.items())
                self.problems.add(path, f"its lists must have equal lengths: {listed}")
            elif lists and len(lengths) == len(lists):
                self.axes.append(Axis(tuple(lists), tuple(values for values in lists.values() if values is not None)))

    def rows(self, raw: object, name: str) -> tuple[Mapping[str, Any], ...]:
        """Return the entries of ``include`` or ``exclude``, each a section of keys with one value."""
        if raw is None:
            return ()
        entries = [raw] if isinstance(raw, dict) else raw
        if not isinstance(entries, list) or not entries:
            given = "an empty one" if raw == [] else describe(raw)
            self.problems.add((name,), f"must be a list of rows such as [{{scheme: hk, h: 0.1}}], not {given}")
            return ()
        found = []
        for index, entry in enumerate(entries):
            flat = dict(_dotted(self._section(entry, (name, index), f"{name}: [{{scheme: hk, h: 0.1}}]")))
            known = [self._known(key, (name, index, key)) for key in flat]  # every one is reported
            if flat and all(known):
                found.append(flat)
        return tuple(found)


def _dotted(section: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield keys such as ``top.c0`` and their values; sections that name a top or a scheme are values."""
    for key, value in section.items():
        if isinstance(value, dict) and value and not {"name", "kind"} & value.keys():
            yield from _dotted(value, f"{prefix}{key}.")
        else:
            yield prefix + key, value
