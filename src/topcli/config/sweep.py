"""Loading of a sweep file: the base experiment, the varied keys and their values.

A sweep is never held as a list of rows: ``Sweep.assignments`` yields the values of the varied keys row by row, and
``config.rows`` turns each into what the row computes.
"""

from __future__ import annotations

import hashlib
import math
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from pydantic import BaseModel, Field

from topcli.config.document import STRICT, Document, describe, plain, unknown_key
from topcli.config.files import find_config, read_document
from topcli.config.models import Name, canonical, name_fault
from topcli.config.overrides import apply_overrides, is_override
from topcli.config.ranges import MAX_SWEEP_ROWS, Range, is_range, read_axis
from topcli.config.sections import read_top
from topcli.config.text import KeyPath, to_yaml
from topcli.contracts import Top
from topcli.errors import UnknownNameError, UsageError, quoted
from topcli.schemes.own_tops import forms
from topcli.schemes.registry import find_scheme
from topcli.tops import CUSTOM, TOPS

PLAIN = ("scheme", "h", "N", "T", "top", "output.every")
BASE = ("top", "initial", "scheme", "h", "N", "T", "output")
"""Keys of an experiment that a sweep may have; ``T`` is the duration N*h."""
INTEGER_KEYS = ("N", "output.every", "sample", "seed")
"""Keys whose values are whole numbers; those of a range are rounded."""
FIXED = {
    "name": "cannot be varied: the rows are named after the sweep",
    "ensemble": "cannot be varied: a row is one trajectory; vary initial states, or draw them by random",
    "output.format": "cannot be varied: it does not change what a row computes",
    "output.columns": "cannot be varied: it does not change what a row computes",
    "sample": "needs the section random, which says what is drawn",
    "seed": "needs the section random, which says what is drawn",
}
"""Reasons why a key cannot be varied."""


class SweepFile(BaseModel):
    """The keys of a sweep file; the sections of keys and values are read by ``Axes``."""

    model_config = STRICT

    name: Name | None = None
    base: Any = Field(description="an experiment: its top, initial, scheme, h and N or T")
    grid: Any = None
    zip: Any = None
    exclude: Any = None
    random: Any = None
    measure: tuple[str, ...] | None = None


Assignment = tuple[Any, ...]
"""Values of the varied keys in one row, in the order of ``Sweep.keys``."""


@dataclass(frozen=True)
class Axis:
    """Values that vary together: for each of ``keys`` a column of equal length."""

    keys: tuple[str, ...]
    columns: tuple[Sequence[Any], ...]

    def __len__(self) -> int:
        return len(self.columns[0])


@dataclass(frozen=True)
class Sweep:
    """A validated sweep file; the values of its rows are validated when ``config.rows`` reads them.

    ``data`` is the file as plain data, complete and with overrides applied; ``places`` of its keys are in ``document``.
    """

    name: str
    document: Document
    axes: tuple[Axis, ...]
    exclude: tuple[Mapping[str, Any], ...]
    keys: tuple[str, ...]
    ranges: Mapping[str, Range]
    """Keys whose values are a range."""

    @property
    def log(self) -> list[str]:
        """Keys whose values are a logarithmic range."""
        return [key for key, values in self.ranges.items() if values.spacing == "log"]

    @property
    def base(self) -> dict[str, Any]:
        """The experiment that rows start from."""
        return self.document.data["base"]

    @property
    def measures(self) -> tuple[str, ...]:
        """Names of the measures."""
        return tuple(self.document.data.get("measure") or ())

    @cached_property
    def random(self) -> dict[str, Any]:
        """The section ``random``, with keys such as ``top.c0`` in one piece; empty if there is none."""
        raw = self.document.data.get("random")
        return dict(_dotted(raw, ("top",))) if isinstance(raw, dict) else {}

    @cached_property
    def drawn(self) -> tuple[str, ...]:
        """Drawn components of the initial state and parameters of the top, as ``initial.NAME`` and ``top.NAME``."""
        components = {
            f"initial.{component}": None
            for cls in TOPS.values()
            for vector, (start, stop) in cls.vectors.items()
            if vector in self.random
            for component in cls.components[start:stop]
        }
        return (*components, *(key for key in self.random if key.startswith("top.")))

    @property
    def count(self) -> int:
        """Number of rows, without looking which ones are excluded."""
        return math.prod(map(len, self.axes))

    @property
    def count_left(self) -> int:
        """Number of rows that are not excluded."""
        return sum(1 for _ in self.assignments()) if self.exclude else self.count

    def assignments(self) -> Iterator[Assignment]:
        """Yield the values of the varied keys row by row; the last axis varies fastest."""
        exclusions = [[(self.keys.index(key), value) for key, value in row.items()] for row in self.exclude]
        for values in _product(self.axes):
            if not any(all(values[at] == value for at, value in row) for row in exclusions):
                yield values

    def resolved(self) -> dict[str, Any]:
        """Return the sweep file as plain data with the scene of ``base`` and all overrides written out."""
        data = self.document.data | {"name": self.name}
        return {key: data[key] for key in SweepFile.model_fields if data.get(key) not in (None, {}, [])}

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


def load_sweep(source: Path | str | Mapping[str, Any], overrides: Sequence[str] = ()) -> Sweep:
    """Load a sweep file (.yaml, .yml or .toml), a packaged sweep such as ``heavy_drift``, or a sweep given as a dict.

    ``overrides`` are ``key=value`` texts such as ``base.N=100``. Raises ConfigError or UnknownNameError with
    ``file:line``, the key, what is wrong and what would be right.
    """
    if isinstance(source, (str, os.PathLike)):
        path = find_config(source, sweep=True)
        document = read_document(path)
    else:
        path, document = Path("sweep"), Document({})
        document.data = plain(source, document)
    _expand_base(document, path.parent)
    apply_overrides(document, overrides)
    for section in ("grid", "zip"):  # keys such as top.c0, also where TOML or an override has made sections
        raw = document.data.get(section)
        if isinstance(raw, dict):
            flat = dict(_dotted(raw))
            places = {(section, key): document.place((section, *key.split("."))) for key in flat}
            document.places |= {key: place for key, place in places.items() if place and key not in document.places}
            document.data[section] = flat
    return _sweep(document, path.stem)


def _expand_base(document: Document, folder: Path) -> None:
    """Replace the name of a scene or config in ``base`` by its content."""
    source = document.data.get("base")
    if not isinstance(source, str):
        return
    try:
        path = find_config(source)
    except UnknownNameError as error:
        raise UnknownNameError(document.message(("base",), str(error))) from None
    inner = read_document(folder / path)
    inner.data.pop("name", None)
    document.data["base"] = inner.data
    document.places |= {("base", *key): place for key, place in inner.places.items() if key}


def _dotted(section: Mapping[str, Any], inside: Sequence[str] = (), prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield keys such as ``top.c0`` and their values, of the sections ``inside`` or of all.

    Ranges, and sections that name a top or a scheme, are values.
    """
    for key, value in section.items():
        whole = not isinstance(value, dict) or not value or is_range(value) or {"name", "kind"} & value.keys()
        if whole or (inside and key not in inside):
            yield prefix + key, value
        else:
            yield from _dotted(value, (), f"{prefix}{key}.")


def _sweep(document: Document, default_name: str) -> Sweep:
    data = document.data
    if "base" not in data and "top" in data:
        document.fault((), "this is an experiment; `topcli run` takes experiments, and a sweep has one in base")
        document.check()
    document.read(SweepFile, data)
    name = default_name if data.get("name") is None else data["name"]
    if data.get("name") is None and (fault := name_fault(default_name)):
        document.fault(("name",), f"missing, and the file name cannot be used instead: it {fault}")
    measures = data.get("measure") or ()
    for measure in {name: None for name in measures if measures.count(name) > 1} if isinstance(measures, list) else ():
        document.fault(("measure",), f"names {quoted(str(measure))} twice")
    base = _base(data.get("base"), document) if "base" in data else {}
    axes = Axes(data, base, document)
    keys = tuple(axes.values)
    exclude = axes.exclusions()
    axes.check_exclusions(exclude)
    axes.check_drawn(keys)
    document.check()
    sweep = Sweep(name, document, tuple(axes.axes), exclude, keys, axes.ranges)
    if not keys:
        document.fault((), "varies nothing: give grid, zip or random; for example grid: {h: [0.1, 0.2]}")
    elif sweep.count > MAX_SWEEP_ROWS:
        document.fault((), f"{sweep.count} rows; a sweep has at most {MAX_SWEEP_ROWS}")
    elif next(sweep.assignments(), None) is None:
        document.fault(("exclude",), "excludes every row, so the sweep would have none")
    document.check()
    return sweep


def _base(base: Any, document: Document) -> dict[str, Any]:
    """Return the experiment of a sweep, with its unknown keys reported."""
    if base is None:
        document.fault(("base",), f"missing; give {SweepFile.model_fields['base'].description}")
    elif not isinstance(base, dict):
        document.fault(("base",), f"must be an experiment or the name of a scene, not {describe(base)}")
    reasons = {
        "name": "the base has no name; the rows are named after the sweep",
        "ensemble": "a row is one trajectory; vary initial states by grid, or by random",
        "section": "a row measures whole orbits; `topcli run` records sections, of ensembles too",
    }
    for key in base if isinstance(base, dict) else ():
        if key not in BASE:
            document.fault(("base", key), reasons.get(key) or unknown_key(key, BASE))
    return base if isinstance(base, dict) else {}


class Axes:
    """The axes of a sweep file, ``values`` all values of their keys, and ``ranges`` those given as a range."""

    def __init__(self, data: dict[str, Any], base: dict[str, Any], document: Document) -> None:
        self.data, self.document, self.known = data, document, known_keys(data, base)
        self.axes: list[Axis] = []
        self.values: dict[str, Sequence[Any]] = {}
        self.ranges: dict[str, Range] = {}
        for key, raw in self._section(data.get("grid"), ("grid",), "grid: {h: [0.1, 0.2]}").items():
            values = self._read(key, raw, ("grid", key))
            if values is not None:
                self.axes.append(Axis((key,), (values,)))
        random = data.get("random")
        count = random.get("count", 1) if isinstance(random, dict) and "sample" not in self.values else None
        if isinstance(count, int) and 1 <= count <= MAX_SWEEP_ROWS:
            self.values["sample"] = range(1, count + 1)
            self.axes.append(Axis(("sample",), (self.values["sample"],)))
        zipped = data.get("zip")
        for index, raw in enumerate(zipped) if isinstance(zipped, list) and zipped else ((None, zipped),):
            self._zip(raw, ("zip",) if index is None else ("zip", index))

    def _section(self, raw: object, path: KeyPath, example: str) -> dict[str, Any]:
        if isinstance(raw, dict) and raw:
            return raw
        if raw is not None:
            given = "an empty one" if raw == {} else describe(raw)
            self.document.fault(path, f"must be a section of keys and their values, not {given}; for example {example}")
        return {}

    def _known(self, key: str, path: KeyPath) -> bool:
        if key not in self.known:
            self.document.fault(path, FIXED.get(key) or unknown_key(key, self.known))
        return key in self.known

    def _read(self, key: str, raw: Any, path: KeyPath) -> Sequence[Any] | None:
        """Values of a key that no axis has yet; None if they are wrong."""
        if not self._known(key, path):
            return None
        if key in self.values:
            self.document.fault(path, "is varied twice; keep one of them")
            return None
        if key in ("sample", "seed") and is_range(raw) and "count" not in raw:
            first, last = raw.get("from"), raw.get("to")
            if isinstance(first, int) and isinstance(last, int):
                raw = {**raw, "count": max(1, last - first + 1)}
        with self.document.at(*path, model=Range):
            axis = read_axis(raw)
            if isinstance(axis, Range):
                self.ranges[key] = axis
                values = axis.values()
                if key in INTEGER_KEYS:
                    values = list(dict.fromkeys(map(round, values)))
            else:
                values = axis
                _check_list(values, key, unique=path[0] == "grid")
            self.values[key] = values
            return values
        return None

    def _zip(self, raw: object, path: KeyPath) -> None:
        """Add the axis of a section of lists that go together."""
        section = self._section(raw, path, "zip: {h: [0.1, 0.2], N: [200, 100]}")
        lists = {key: self._read(key, values, (*path, key)) for key, values in section.items()}
        columns = {key: values for key, values in lists.items() if values is not None}
        if len(set(map(len, columns.values()))) > 1:
            listed = ", ".join(f"{key} has {len(values)}" for key, values in columns.items())
            self.document.fault(path, f"its lists must have equal lengths: {listed}")
        elif lists and len(columns) == len(lists):
            self.axes.append(Axis(tuple(columns), tuple(columns.values())))

    def exclusions(self) -> tuple[Mapping[str, Any], ...]:
        """Return the entries of ``exclude``, each a section of keys with one value."""
        raw = self.data.get("exclude")
        entries = [raw] if isinstance(raw, dict) else [] if raw is None else raw
        if not isinstance(entries, list) or raw == []:
            given = "an empty one" if raw == [] else describe(raw)
            self.document.fault(("exclude",), f"must be a list of rows such as [{{scheme: hk, h: 0.1}}], not {given}")
            return ()
        rows = []
        for index, entry in enumerate(entries):
            row = dict(_dotted(self._section(entry, ("exclude", index), "exclude: [{scheme: hk, h: 0.1}]")))
            known = [self._known(key, ("exclude", index, key)) for key in row]  # every one is reported
            if row and all(known):
                rows.append(row)
        return tuple(rows)

    def check_exclusions(self, exclude: Sequence[Mapping[str, Any]]) -> None:
        """Report exclusions that no row can match, unless an override has set the values in the grid."""
        for index, row in enumerate(exclude):
            for key, value in row.items():
                values = self.values.get(key)
                if values is None:
                    varied = ", ".join(self.values) or "none"
                    text = f"is not varied by grid or zip, so nothing is excluded; varied: {varied}"
                    self.document.fault(("exclude", index, key), text)
                elif value not in values and not is_override(self.document.place(("grid", key))):
                    shown = ", ".join(map(repr, list(values)[:5])) + (", ..." if len(values) > 5 else "")
                    self.document.fault(("exclude", index, key), f"no row has the value {value!r}; values: {shown}")

    def check_drawn(self, keys: Sequence[str]) -> None:
        """Report vectors and parameters that are drawn and varied as well; the centre of ``near`` may vary."""
        random = self.data.get("random")
        for name, rule in random.items() if isinstance(random, dict) else ():
            if name in ("count", "seed") or (isinstance(rule, dict) and "near" in rule):
                continue
            for key in keys:
                vector = key.removeprefix("initial.")
                if key == name or (vector != key and name in (vector, vector.rstrip("0123456789"))):
                    text = f"is drawn in every row, and {key} is varied; keep one of them"
                    self.document.fault(("random", name), text)


def _check_list(values: list[Any], key: str, unique: bool) -> None:
    """Refuse a single vector in the place of a list of vectors, and equal values. Raises ValueError."""
    vectors = {name for cls in TOPS.values() for name, (start, stop) in cls.vectors.items() if stop - start > 1}
    if key.removeprefix("initial.") in vectors and not any(isinstance(value, list) for value in values):
        raise ValueError(f"must be a list of vectors, each a list of numbers; for a single one write [{values}]")
    seen: set[str] = set()
    for value in values if unique else ():
        text = repr(value)
        if text in seen:
            raise ValueError(f"contains {text if isinstance(value, list) else describe(value)} twice")
        seen.add(text)


def known_keys(data: dict[str, Any], base: dict[str, Any]) -> list[str]:
    """Return the keys that rows of the sweep file ``data`` may set; unknown tops and schemes add none."""
    keys = [*PLAIN]
    classes: list[type[Top]] = []
    for raw in _given(data, base, "top"):
        kind = raw.get("kind") if isinstance(raw, dict) else raw
        if kind == CUSTOM:
            cls, _ = read_top(raw, None, Document({}))
            classes += [cls] if cls else []
            keys += [f"top.parameters.{name}" for name in cls.model_fields] if cls else []
            continue
        try:
            classes += forms(kind) if isinstance(kind, str) else []
        except UsageError:
            continue
    classes = list(dict.fromkeys(classes)) or list(TOPS.values())
    for cls in classes:
        keys += [f"top.{name}" for name in cls.model_fields]
        keys += [f"initial.{name}" for name in (*cls.vectors, *cls.components)]
    keys += ["initial.normalize", "scheme.compose"]
    for raw in _given(data, base, "scheme"):
        name = raw.get("name") if isinstance(raw, dict) else raw
        for cls in classes if isinstance(name, str) else ():
            try:
                keys += [f"scheme.{option}" for option in find_scheme(str(name), cls.form).options.model_fields]
            except UsageError:
                continue
    if data.get("random") is not None:
        keys += ["sample", "seed"]
    return list(dict.fromkeys(keys))


def _given(data: dict[str, Any], base: dict[str, Any], key: str) -> Iterator[Any]:
    """Yield every value of ``key`` in the base and in the sections that vary it, valid or not."""
    yield base.get(key)
    for name in ("grid", "zip", "exclude"):
        raw = data.get(name)
        for section in raw if isinstance(raw, list) else [raw]:
            values = section.get(key) if isinstance(section, dict) else None
            yield from values if name in ("grid", "zip") and isinstance(values, list) else [values]
