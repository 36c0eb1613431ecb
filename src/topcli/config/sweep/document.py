"""From a sweep file to a validated ``Sweep``: its base experiment, the varied keys and their values.

A sweep is never held as a list of rows: ``Sweep.assignments`` yields the values of the varied keys row by row, and
``config.sweep.rows`` turns each into what the row computes.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from topcli.config.document import Document, describe, plain
from topcli.config.load import find_config, read_document, scene_folder
from topcli.config.models import canonical, name_fault
from topcli.config.overrides import apply_overrides
from topcli.config.problems import Problems, unknown_key
from topcli.config.sweep.axes import Axis, AxisReader, check_drawn, check_exclusions
from topcli.config.sweep.keys import known_keys
from topcli.config.sweep.values import MAX_ROWS, is_range
from topcli.config.yaml_text import to_yaml
from topcli.errors import UnknownNameError, nearest, quoted
from topcli.tops import TOPS

SECTIONS = ("name", "base", "grid", "zip", "include", "exclude", "random", "measure", "store")
BASE = ("top", "initial", "scheme", "h", "N", "T", "output")
"""Keys of an experiment that a sweep may have; ``T`` is the duration N*h."""
STORE = ("none", "series")


class _Missing:
    """The value of a key that a row does not set."""

    def __repr__(self) -> str:
        return "MISSING"


MISSING: Any = _Missing()
Assignment = tuple[Any, ...]
"""Values of the varied keys in one row, in the order of ``Sweep.keys``; MISSING where the base has the word."""


@dataclass(frozen=True)
class Sweep:
    """A validated sweep file; the values of its rows are validated when ``config.sweep.rows`` reads them.

    ``data`` is the file as plain data, complete and with overrides applied; ``places`` of its keys are in ``document``.
    """

    name: str
    document: Document
    axes: tuple[Axis, ...]
    include: tuple[Mapping[str, Any], ...]
    exclude: tuple[Mapping[str, Any], ...]
    keys: tuple[str, ...]
    log: tuple[str, ...]
    """Keys whose values are a logarithmic range."""
    ranged: frozenset[str]
    """Keys whose values are a range."""

    @property
    def base(self) -> dict[str, Any]:
        """The experiment that rows start from."""
        return self.document.data.get("base", {})

    @property
    def measures(self) -> tuple[str, ...]:
        """Names of the measures."""
        return tuple(self.document.data.get("measure") or ())

    @property
    def store(self) -> str:
        """``series`` if every row keeps its run folder, otherwise ``none``."""
        return self.document.data.get("store") or "none"

    @cached_property
    def drawn(self) -> tuple[str, ...]:
        """Drawn components of the initial state and parameters of the top, as ``initial.NAME`` and ``top.NAME``."""
        section = self.document.data.get("random")
        raw = section if isinstance(section, dict) else {}
        inner = raw.get("top")
        found = [key for key in raw if key.startswith("top.")]
        found += [f"top.{key}" for key in inner] if isinstance(inner, dict) else []
        components = {
            f"initial.{component}": None
            for cls in TOPS.values()
            for vector, (start, stop) in cls.vectors.items()
            if vector in raw
            for component in cls.components[start:stop]
        }
        return (*components, *found)

    @property
    def count(self) -> int:
        """Number of rows, without looking which ones are excluded."""
        return math.prod(map(len, self.axes)) * bool(self.axes) + len(self.include)

    def assignments(self) -> Iterator[Assignment]:
        """Yield the values of the varied keys row by row; the last axis varies fastest, included rows come last."""
        if self.axes:
            at = [self.keys.index(key) for axis in self.axes for key in axis.keys]
            straight = at == list(range(len(self.keys)))
            for values in _product(self.axes):
                if not straight:
                    row = [MISSING] * len(self.keys)
                    for place, value in zip(at, values, strict=True):
                        row[place] = value
                    values = tuple(row)
                if not self._excluded(values):
                    yield values
        for extra in self.include:
            yield tuple(extra.get(key, MISSING) for key in self.keys)

    @cached_property
    def _exclusions(self) -> list[list[tuple[int, Any]]]:
        return [[(self.keys.index(key), value) for key, value in one.items()] for one in self.exclude]

    def _excluded(self, values: Assignment) -> bool:
        return any(all(values[place] == value for place, value in one) for one in self._exclusions)

    def resolved(self) -> dict[str, Any]:
        """Return the sweep file as plain data with the scene of ``base`` and all overrides written out."""
        data = self.document.data
        return {"name": self.name, **{key: data[key] for key in SECTIONS[1:] if data.get(key) not in (None, {}, [])}}

    @cached_property
    def digest(self) -> str:
        """SHA-256 of the sweep file as plain data, 64 hexadecimal digits."""
        return hashlib.sha256(canonical(self.resolved()).encode()).hexdigest()

    def to_yaml(self) -> str:
        """Return the resolved sweep file as YAML."""
        return to_yaml(self.resolved())


def _product(axes: Sequence[Axis], before: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Yield every combination of the axes; unlike itertools.product, it copies no axis."""
    for values in zip(*axes[0].columns, strict=True):
        if len(axes) == 1:
            yield before + values
        else:
            yield from _product(axes[1:], before + values)


def sweep_files() -> dict[str, Path]:
    """Files of the packaged sweeps by name."""
    folder = scene_folder() / "sweeps"
    return {path.stem: path for path in sorted(folder.iterdir())} if folder.is_dir() else {}


def find_sweep(source: Path | str) -> Path:
    """Return the file of ``source``: itself if it is named like one, otherwise the packaged sweep of that name.

    Raises UnknownNameError with the nearest packaged sweeps.
    """
    path, text = Path(source), str(source)
    if path.suffix or "/" in text:
        return path  # reading it reports what is wrong with it
    found = sweep_files()
    name = text.lower().replace("-", "_")
    if name not in found:
        raise UnknownNameError(
            f"no packaged sweep is called {quoted(text)} (files end in .yaml or .toml); {nearest(name, found)}"
        )
    return found[name]


def load_sweep(source: Path | str, overrides: Sequence[str] = ()) -> Sweep:
    """Load a sweep file (.yaml, .yml or .toml) or a packaged sweep such as ``heavy_drift``.

    ``overrides`` are ``key=value`` texts such as ``base.N=100``. Raises ConfigError or UnknownNameError with
    ``file:line``, the key, what is wrong and what would be right.
    """
    path = find_sweep(source)
    document = read_document(path)
    _expand_base(document, path.parent)
    apply_overrides(document, overrides)
    _flatten(document)
    return _sweep(document, path.stem)


def sweep_from(data: Mapping[str, Any], overrides: Sequence[str] = ()) -> Sweep:
    """Return the sweep of a sweep file given as a dict. Raises as ``load_sweep``; the messages name the key."""
    document = Document({})
    document.data = plain(data, document)
    _expand_base(document, Path())
    apply_overrides(document, overrides)
    _flatten(document)
    return _sweep(document, "sweep")


def _expand_base(document: Document, folder: Path) -> None:
    """Replace the name of a scene or config in ``base`` by its content."""
    source = document.data.get("base")
    if not isinstance(source, str):
        return
    try:
        path = find_config(source)
    except UnknownNameError as error:
        raise UnknownNameError(
            ": ".join(part for part in (document.place(("base",)), "base", str(error)) if part)
        ) from None
    if not path.is_absolute():
        path = folder / path
    inner = read_document(path)
    inner.data.pop("name", None)
    document.data["base"] = inner.data
    document.places |= {("base", *key): place for key, place in inner.places.items() if key}


def _flatten(document: Document) -> None:
    """Write keys such as ``top.c0`` of the grid in one piece, also where TOML or an override has made sections."""
    for section in ("grid", "zip"):
        raw = document.data.get(section)
        if not isinstance(raw, dict):
            continue
        flat: dict[str, Any] = {}

        def visit(path: tuple[str, ...], value: Any, section: str = section, flat: dict[str, Any] = flat) -> None:
            if isinstance(value, dict) and not is_range(value) and value:
                for key, inner in value.items():
                    visit((*path, key), inner)
                return
            key = ".".join(path)
            flat[key] = value
            place = document.place((section, *path))
            if place:
                document.places[(section, key)] = place

        for key, value in raw.items():
            visit((key,), value)
        document.data[section] = flat


def _sweep(document: Document, default_name: str) -> Sweep:
    problems = Problems(document)
    data = document.data
    if "base" not in data and "top" in data:
        problems.add((), "this is an experiment; `topcli run` takes experiments, and a sweep has one in base")
        problems.raise_any()
    for key in data:
        if key not in SECTIONS:
            problems.add((key,), unknown_key(key, SECTIONS))
    name = _name(data, default_name, problems)
    base = _base(data, problems)
    if data.get("store") not in (None, *STORE):
        problems.add(("store",), f"must be {' or '.join(STORE)}, not {describe(data['store'])}")
    _check_measures(data.get("measure"), problems)
    known = known_keys(data, base)
    reader = AxisReader(problems, known)
    reader.random(data.get("random"))
    reader.grid(data.get("grid"))
    reader.zip(data.get("zip"))
    include = reader.rows(data.get("include"), "include")
    keys = tuple(dict.fromkeys([*reader.seen, *(key for row in include for key in row)]))
    exclude = reader.rows(data.get("exclude"), "exclude")
    check_exclusions(exclude, reader, problems)
    check_drawn(data.get("random"), keys, problems)
    problems.raise_any()
    if not keys:
        problems.add((), "varies nothing: give grid, zip, include or random; for example grid: {h: [0.1, 0.2]}")
    sweep = Sweep(
        name, document, tuple(reader.axes), include, exclude, keys, tuple(reader.log), frozenset(reader.ranged)
    )
    if sweep.count > MAX_ROWS:
        problems.add((), f"{sweep.count} rows; a sweep has at most {MAX_ROWS}")
    problems.raise_any()
    if next(sweep.assignments(), None) is None:
        problems.add(("exclude",), "excludes every row, so the sweep would have none")
    problems.raise_any()
    return sweep


def _name(data: dict[str, Any], default_name: str, problems: Problems) -> str:
    name = data.get("name")
    given = default_name if name is None else name
    if not isinstance(given, str):
        problems.add(("name",), f"must be text (in quotes, if it looks like something else), not {describe(given)}")
        return ""
    if fault := name_fault(given):
        missing = "missing, and the file name cannot be used instead: it " if name is None else ""
        problems.add(("name",), missing + fault)
    return given


def _base(data: dict[str, Any], problems: Problems) -> dict[str, Any]:
    base = data.get("base")
    if base is None:
        problems.add(("base",), "missing; give an experiment: its top, initial, scheme, h and N or T")
        return {}
    if not isinstance(base, dict):
        problems.add(("base",), f"must be an experiment or the name of a scene, not {describe(base)}")
        return {}
    for key in base:
        if key == "name":
            problems.add(("base", key), "the base has no name; the rows are named after the sweep")
        elif key == "ensemble":
            problems.add(("base", key), "a row is one trajectory; vary initial states by grid, or by random")
        elif key not in BASE:
            problems.add(("base", key), unknown_key(key, BASE))
    return base


def _check_measures(raw: object, problems: Problems) -> None:
    if raw is None:
        return
    if not isinstance(raw, list) or not all(isinstance(name, str) for name in raw):
        problems.add(("measure",), "must be a list of names such as [drift.energy, seconds]; see topcli list measures")
        return
    for index, name in enumerate(raw):
        if name in raw[:index]:
            problems.add(("measure",), f"names {quoted(name)} twice")
