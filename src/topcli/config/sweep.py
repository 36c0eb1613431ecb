"""Sweeps: one experiment for every combination of values of config keys.

Rows that differ in components of the initial state or in the sample of a random draw alone are a group: one experiment,
read like a config, with many initial states. So a million rows are a few arrays of numbers.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, reduce
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, BeforeValidator

from topcli.config.document import STRICT, Document, number_of, unknown_key
from topcli.config.ensemble import MAX_SWEEP_ROWS, Interval, Range, is_range, read_axis
from topcli.config.files import find_config, read_document
from topcli.config.load import read_experiment
from topcli.config.models import MAX_STEPS, Experiment, Name, folder_name_fault
from topcli.config.states import Random, drawn_number, drawn_states, read_random
from topcli.config.text import KeyPath, to_yaml
from topcli.contracts import Array, Top
from topcli.store.identity import canonical

STEPS = ("h", "T", "N", "output.every")
"""Keys of the steps of a row."""
SAMPLE = "sample"
"""Key of the number of a random draw."""
_KEYS = ("scheme", "top", "scheme.OPTION", "top.PARAMETER", "initial.VECTOR", "initial.COMPONENT", *STEPS)
UNFIT = ("name", "ensemble", "section", "precision", "max_digits", "output.columns", "output.attitude")
"""Keys of an experiment that a row of a sweep, one trajectory in doubles without a series, cannot have."""

Sections = Annotated[list[dict[str, Any]], BeforeValidator(lambda raw: [raw] if isinstance(raw, dict) else raw)]


class SweepFile(BaseModel):
    """Content of a sweep file."""

    model_config = STRICT

    name: Name | None = None
    base: dict[str, Any]
    """an experiment: its top, initial, scheme, h and N or T"""
    grid: dict[str, Any] = {}
    zip: Sections = []
    exclude: Sections = []
    random: dict[str, Any] = {}
    measure: tuple[str, ...] = ()


class Group(NamedTuple):
    """Rows of a sweep that share an experiment except for their initial states.

    ``experiment`` has the initial state of the first row; ``states`` (m, d) are those of all rows, ``numbers`` (m,) the
    numbers of the rows in the order of the sweep, and ``values`` the values of each varied key as a table shows them.
    """

    experiment: Experiment
    states: Array
    numbers: NDArray[np.int64]
    values: Mapping[str, Sequence[Any]]


Axis = Mapping[str, Sequence[Any]]
"""Values of keys that vary together, of equal length."""


@dataclass(frozen=True)
class Sweep:
    """A sweep file. Its rows are read, and refused, by ``groups``.

    The last of the ``axes`` varies fastest; rows that agree with an entry of ``file.exclude`` are left out.
    """

    name: str
    document: Document
    file: SweepFile
    axes: tuple[Axis, ...]
    intervals: Mapping[str, Interval]
    """Intervals from which parameters are drawn, by key."""

    @cached_property
    def keys(self) -> tuple[str, ...]:
        """Varied keys."""
        return tuple(key for axis in self.axes for key in axis)

    @property
    def measures(self) -> tuple[str, ...]:
        """Names of the measures."""
        return tuple(dict.fromkeys(self.file.measure))

    @cached_property
    def vectors(self) -> dict[str, Any]:
        """Distributions of the vectors that are drawn, as the file gives them."""
        others = (*Random.model_fields, *self.intervals)
        return {key: rule for key, rule in self.file.random.items() if key not in others}

    @cached_property
    def places(self) -> NDArray[np.int64]:
        """Place of each row on each axis (rows, axes), without those that are excluded."""
        rows = np.ones([_size(axis) for axis in self.axes], dtype=bool)
        for entry in self.file.exclude:
            rows &= ~reduce(np.logical_and.outer, [_matches(axis, entry) for axis in self.axes])
        return np.argwhere(rows)

    @property
    def count(self) -> int:
        """Number of rows."""
        return len(self.places)

    def resolved(self) -> dict[str, Any]:
        """Return the sweep file as plain data with the scene of ``base`` and all overrides written out."""
        data = self.file.model_dump(mode="json") | {"name": self.name}
        return {key: value for key, value in data.items() if value not in ({}, [])}

    @cached_property
    def digest(self) -> str:
        """SHA-256 of the sweep file as plain data, 64 hexadecimal digits."""
        return hashlib.sha256(canonical(self.resolved()).encode()).hexdigest()

    def to_yaml(self) -> str:
        """Return the resolved sweep file as YAML."""
        return to_yaml(self.resolved())

    def groups(self) -> Iterator[Group]:
        """Yield the rows in groups. Raises ConfigError or UnknownNameError for the first group with a mistake."""
        outer = [i for i in range(len(self.axes)) if i not in self._columns]
        if not outer:
            yield self._group(np.arange(self.count))
            return
        shape = [_size(self.axes[i]) for i in outer]
        experiments = np.asarray(np.ravel_multi_index(tuple(self.places[:, outer].T), shape))
        order = np.argsort(experiments, kind="stable")
        for numbers in np.split(order, np.flatnonzero(np.diff(experiments[order])) + 1):
            yield self._group(numbers)

    def row(self, number: int) -> Experiment:
        """Row ``number`` as an experiment. Raises IndexError."""
        if not 0 <= number < self.count:
            raise IndexError(f"{self.name} has no row {number}; it has {self.count}")
        return self._group(np.array([number])).experiment.renamed(f"{self.name}_{number}")

    def drawn(self, group: Group) -> dict[str, Any]:
        """Drawn components of the initial states (m,) and drawn parameters of the top of a group, by key."""
        top = group.experiment.top
        places = [i for name, span in top.vectors.items() if name in self.vectors for i in range(*span)]
        components = {f"initial.{top.components[i]}": group.states[:, i] for i in places}
        return components | {key: getattr(top, key.rpartition(".")[2]) for key in self.intervals}

    @cached_property
    def _columns(self) -> dict[int, dict[str, NDArray[Any]]]:
        """Axes that vary only samples and components of the initial state, by their numbers, as arrays."""
        samples = not self.intervals  # else each sample has a top of its own
        return {
            i: {key: np.array(column, dtype=int if key == SAMPLE else float) for key, column in axis.items()}
            for i, axis in enumerate(self.axes)
            if all(
                (samples and key == SAMPLE) or (key.startswith("initial.") and {*map(type, column)} <= {int, float})
                for key, column in axis.items()
            )
        }

    def _group(self, numbers: NDArray[np.int64]) -> Group:
        """Group of the rows ``numbers`` (m,), which differ in their initial states alone."""
        values, columns = dict[str, Any](), dict[str, NDArray[Any]]()
        for i, axis in enumerate(self.axes):
            if i in self._columns:
                columns |= {key: column[self.places[numbers, i]] for key, column in self._columns[i].items()}
            else:
                values |= {key: column[self.places[numbers[0], i]] for key, column in axis.items()}
        seed, sample = self.file.random.get("seed", 0), values.get(SAMPLE, 1)
        chosen = {key: value for key, value in values.items() if key != SAMPLE}
        chosen |= {key: interval.value(drawn_number(seed, key, sample)) for key, interval in self.intervals.items()}

        # the keys of the base, in which sections are set before keys inside them
        places = self._places_in_rows
        document = Document(dict(self.file.base), dict(places))
        if "h" in document.data or "h" in values:
            document.drop_partner(values)
        for key in sorted(chosen, key=lambda key: key.count(".")):
            document.set(tuple(key.split(".")), chosen[key], places.get(("grid", key), ""))
        _fit_step(document.data, any(is_range(section.get("h")) for section in (self.file.grid, *self.file.zip)))

        # the states, which may need the top
        components = {key.removeprefix("initial."): column for key, column in columns.items() if key != SAMPLE}
        document.places |= {("initial", key): places.get(("grid", f"initial.{key}"), "") for key in components}
        samples, states = columns.get(SAMPLE, np.full(len(numbers), sample)), np.empty((0, 0))

        def start(top: Top, initial: object) -> Array:
            nonlocal states
            states = drawn_states(top, initial, document, self.vectors, samples, seed, columns=components)
            return states

        experiment = read_experiment(document, self.name, start, [*components, *self.vectors])
        table = {
            key: columns[key].tolist() if key in columns else [_shown(key, values[key], experiment)] * len(numbers)
            for key in self.keys
        }
        return Group(experiment, states, numbers, table)

    @cached_property
    def _places_in_rows(self) -> dict[KeyPath, str]:
        """Places of the keys of the base as keys of an experiment, and of the varied keys as keys of the grid."""
        places = {path[1:] if path[:1] == ("base",) else path: at for path, at in self.document.places.items()}
        zipped = {("grid", path[-1]): place for path, place in places.items() if path[:1] == ("zip",) and len(path) > 1}
        return zipped | places


def _size(axis: Axis) -> int:
    return len(next(iter(axis.values())))


def _matches(axis: Axis, entry: Mapping[str, Any]) -> NDArray[np.bool_]:
    """True for each value of the axis that agrees with the keys of ``entry``."""
    rows = zip(*axis.values(), strict=True)
    return np.array([all(value == entry.get(key, value) for key, value in zip(axis, row, strict=True)) for row in rows])


def _fit_step(data: dict[str, Any], spaced: bool) -> None:
    """Make h and N of T: h = T/N if h is missing, and of an h in a range (``spaced``) the nearest that divides T."""
    h, N, T = (number_of(data.get(key)) for key in ("h", "N", "T"))
    if T and N and data.get("h") is None:
        data["h"] = T / N
        del data["T"]
    elif T and h and data.get("N") is None and spaced and 0.5 <= T / h <= MAX_STEPS:
        data["N"] = round(T / h)
        data["h"] = T / data["N"]
        del data["T"]


def _shown(key: str, value: Any, experiment: Experiment) -> Any:
    """Value of a varied key as a table shows it."""
    steps = {"h": experiment.h, "N": experiment.N, "T": experiment.duration, "output.every": experiment.output.every}
    if key in steps:
        return steps[key]
    if key == "scheme" and isinstance(value, dict):
        texts = (f"{name}={_flat(option)}" for name, option in value.items() if name not in ("name", "compose"))
        return ":".join([experiment.scheme.name, *texts])
    if key in ("scheme", "top") and isinstance(value, str):
        return experiment.scheme.name if key == "scheme" else experiment.top.kind
    if number_of(value) is None:
        return _flat(value)
    return value if key.startswith("scheme.") or key == SAMPLE else number_of(value)


def _flat(value: Any) -> str:
    return value if isinstance(value, str) else json.dumps(value)


def load_sweep(source: Path | str | Mapping[str, Any], overrides: Sequence[str] = ()) -> Sweep:
    """Load a sweep file (.yaml, .yml or .toml), a packaged sweep such as ``heavy_drift``, or a sweep given as a dict.

    ``overrides`` are ``key=value`` texts such as ``base.N=100``. Raises ConfigError or UnknownNameError with
    ``file:line``, the key, what is wrong and what would be right.
    """
    document, name = _read_sweep(source, overrides)
    data = {key: value for key, value in document.data.items() if value is not None}
    if "base" not in data and "top" in data:
        document.fault((), "this is an experiment; `topcli run` takes experiments, and a sweep has one in base")
    file = document.read(SweepFile, data)
    if file.name is None and (fault := folder_name_fault(name)):
        document.fault(("name",), f"missing, and the file name cannot be used instead: {fault}")
    for key in UNFIT:  # which have no meaning in a sweep
        *sections, last = path = key.split(".")
        section = file.base.get(sections[0]) if sections else file.base
        if isinstance(section, dict) and section.get(last) is not None:
            document.fault(("base", *path), "cannot be in base: a row is one trajectory in doubles without a series")

    # the rows; defaults are written out, so that the digest does not depend on them
    axes = _read_axes(file, isinstance(data.get("zip"), list), document)
    varied, exclude = [key for axis in axes for key in axis], [dict(_dotted(entry)) for entry in file.exclude]
    for index, entry in enumerate(exclude):
        for key in (key for key in entry if key not in varied):
            document.fault(("exclude", index, key), f"does not vary; varied: {', '.join(varied)}")
    random = file.random and file.random | read_random(file.random, document, "random")[0].model_dump()
    file = file.model_copy(update={"exclude": exclude, "random": random})
    intervals = {
        key: document.read(Interval, rule, "random", key) for key, rule in random.items() if key.startswith("top.")
    }
    sweep = Sweep(file.name or name, document, file, tuple(axes), intervals)
    if not axes:
        document.fault((), "varies nothing: give grid, zip or random; for example grid: {h: [0.1, 0.2]}")
    elif (count := math.prod(map(_size, axes))) > MAX_SWEEP_ROWS:
        document.fault((), f"{count} rows; a sweep has at most {MAX_SWEEP_ROWS}")
    elif not sweep.count:
        document.fault(("exclude",), "excludes every row, so the sweep would have none")
    return sweep


def _read_sweep(source: Path | str | Mapping[str, Any], overrides: Sequence[str]) -> tuple[Document, str]:
    """Return the document of a sweep file with the overrides, and its default name.

    A name in ``base`` is replaced by the content of that config, and keys such as ``top.c0`` are in one piece.
    """
    if isinstance(source, (str, os.PathLike)):
        path = find_config(source, sweep=True)
        document = read_document(path)
    else:
        path, document = Path("sweep"), Document.of(source)
    if isinstance(base := document.data.get("base"), str):
        with document.at("base"):
            config = find_config(base)
        inner = read_document(path.parent / config)
        document.data["base"] = {key: value for key, value in inner.data.items() if key != "name"}
        document.places |= {("base", *key): place for key, place in inner.places.items() if key}
    document.override(overrides)
    for section, inside in (("grid", ()), ("zip", ()), ("random", ("top",))):
        raw = document.data.get(section)
        if isinstance(raw, dict):  # also where TOML or an override has made sections
            document.data[section] = flat = dict(_dotted(raw, inside))
            for key in flat:
                document.places.setdefault((section, key), document.place((section, *key.split("."))))
    return document, path.stem


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


def _read_axes(file: SweepFile, listed: bool, document: Document) -> list[Axis]:
    """Return the axes of the sections ``grid``, ``random`` and ``zip``; ``listed`` says that ``zip`` is a list."""
    sections: list[tuple[KeyPath, dict[str, Any]]] = [(("grid",), {key: raw}) for key, raw in file.grid.items()]
    axes = [_read_axis(path, section, file, document) for path, section in sections]
    if file.random:
        random, _ = read_random(file.random, document, "random")
        axes.append({SAMPLE: list(range(1, random.count + 1))})
    sections = [(("zip", i) if listed else ("zip",), section) for i, section in enumerate(file.zip) if section]
    axes += [_read_axis(path, section, file, document) for path, section in sections]
    varied: set[str] = set()
    for (path, _), axis in zip(sections, axes[len(axes) - len(sections) :], strict=True):
        for key in axis:
            if key in file.grid or key in varied:
                document.fault((*path, key), "is varied twice; keep one of them")
        varied |= axis.keys()
    return axes


def _read_axis(path: KeyPath, section: Mapping[str, Any], file: SweepFile, document: Document) -> Axis:
    """Return the keys of a ``section`` at ``path``, which vary together, with their values."""
    columns: dict[str, Sequence[Any]] = {}
    for key, raw in section.items():
        if key not in _KEYS and not key.startswith(("top.", "initial.", "scheme.")):
            document.fault((*path, key), unknown_key(key, _KEYS))
        # what every row draws cannot vary, but its centre can
        rule = file.random.get(drawn := key if key in file.random else key.removeprefix("initial."))
        if rule is not None and drawn not in Random.model_fields and not (isinstance(rule, dict) and "near" in rule):
            document.fault(("random", drawn), f"is drawn in every row, and {key} is varied; keep one of them")
        axis = read_axis(raw, document, *path, key)
        if isinstance(axis, Range):
            axis = axis.values()
            axis = list(dict.fromkeys(map(round, axis))) if key in ("N", "output.every") else axis
        columns[key] = axis
    if len({len(column) for column in columns.values()}) > 1:
        lengths = ", ".join(f"{key} has {len(column)}" for key, column in columns.items())
        document.fault(path, f"its lists must have equal lengths: {lengths}")
    return columns
