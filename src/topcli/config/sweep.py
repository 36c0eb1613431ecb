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

from topcli.config.document import STRICT, Document, canonical, number_of, plain_data, unknown_key
from topcli.config.files import find_config, read_document
from topcli.config.load import read_experiment
from topcli.config.models import Experiment, Name, folder_name_fault
from topcli.config.overrides import apply_overrides, drop_partner, set_key
from topcli.config.ranges import MAX_STEPS, MAX_SWEEP_ROWS, Interval, Range, is_range, read_axis
from topcli.config.states import NOTHING_DRAWN, Random, drawn_number, many_states
from topcli.config.text import KeyPath, to_yaml
from topcli.contracts import Array, Top
from topcli.errors import UnknownNameError
from topcli.tops import TOPS

STEPS, DRAWN = ("h", "T", "N", "output.every"), ("sample", "seed")
"""Keys of the steps of a row, and of one that is drawn at random."""
_KEYS = ("scheme", "top", "scheme.OPTION", "top.PARAMETER", "initial.VECTOR", "initial.COMPONENT", *STEPS)
UNFIT = ("name", "ensemble", "section", "precision", "max_digits", "output.columns", "output.attitude")
"""Keys of an experiment that a row of a sweep, one trajectory in doubles without a series, cannot have."""
_CHUNK = 1 << 16
"""Most rows of a group; a larger one is yielded in parts."""

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

    The last of the ``axes`` varies fastest; rows that agree with an entry of ``file.exclude`` are left out. ``spaced``
    says that the values of h are a range, and ``intervals`` are the parameters that are drawn.
    """

    name: str
    document: Document
    file: SweepFile
    axes: tuple[Axis, ...]
    spaced: bool
    intervals: Mapping[str, Interval]

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
        return {
            key: rule
            for key, rule in self.file.random.items()
            if key not in Random.model_fields and not key.startswith("top.")
        }

    @cached_property
    def drawn(self) -> tuple[str, ...]:
        """Drawn components of the initial state and parameters of the top, as ``initial.NAME`` and ``top.NAME``."""
        components = {
            f"initial.{component}": None
            for cls in (TOPS.values() if self.vectors else ())  # it imports them
            for vector, (start, stop) in cls.vectors.items()
            if vector in self.vectors
            for component in cls.components[start:stop]
        }
        return (*components, *self.intervals)

    @cached_property
    def numbers(self) -> NDArray[np.int64]:
        """Numbers of the rows, with a dimension for each axis; -1 for those that are excluded."""
        rows = np.ones([_size(axis) for axis in self.axes], dtype=bool)
        for entry in self.file.exclude:
            rows &= ~reduce(np.logical_and.outer, [_matches(axis, entry) for axis in self.axes])
        return np.where(rows, np.cumsum(rows).reshape(rows.shape) - 1, -1)

    @property
    def count_left(self) -> int:
        """Number of rows that are not excluded."""
        return int(self.numbers.max()) + 1

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
        return self._groups(self.numbers)

    def row(self, number: int) -> Experiment:
        """Row ``number`` as an experiment. Raises IndexError."""
        alone = np.where(self.numbers == number, number, -1)
        group = next(self._groups(alone), None) if number >= 0 else None
        if group is None:
            raise IndexError(f"{self.name} has no row {number}; it has {self.count_left}")
        return group.experiment.renamed(f"{self.name}_{number}")

    def _groups(self, numbers: NDArray[np.int64]) -> Iterator[Group]:
        """Yield the rows with these ``numbers``; an experiment is read once for all of its states."""
        samples = not self.intervals  # else each sample has a top of its own
        inner = [i for i, axis in enumerate(self.axes) if _varies_states(axis, samples)]
        outer = [i for i in range(len(self.axes)) if i not in inner]
        shapes = [[_size(self.axes[i]) for i in level] for level in (outer, inner)]
        cells = numbers.transpose([*outer, *inner]).reshape([math.prod(shape) for shape in shapes])
        arrays = [{key: np.array(column, dtype=_kind(key)) for key, column in self.axes[i].items()} for i in inner]
        for place in np.flatnonzero((cells >= 0).any(axis=1)).tolist():
            at = np.unravel_index(place, shapes[0]) if outer else ()
            values = {
                key: column[int(j)] for i, j in zip(outer, at, strict=True) for key, column in self.axes[i].items()
            }
            rows = np.flatnonzero(cells[place] >= 0)
            for start in range(0, len(rows), _CHUNK):
                some = rows[start : start + _CHUNK]
                at = np.unravel_index(some, shapes[1]) if inner else ()
                columns = {key: column[j] for axis, j in zip(arrays, at, strict=True) for key, column in axis.items()}
                yield self._group(values, columns, cells[place, some])

    def _group(
        self, values: Mapping[str, Any], columns: Mapping[str, NDArray[Any]], numbers: NDArray[np.int64]
    ) -> Group:
        """Group of the rows with these ``values`` of some keys, and ``columns`` (m,) of values of the others."""
        random, places = self.file.random, self._places
        document = Document(dict(self.file.base), dict(places))
        sample, seed = values.get("sample", 1), values.get("seed", random.get("seed", 0))
        chosen = dict(values)
        chosen |= {key: interval.value(drawn_number(seed, key, sample)) for key, interval in self.intervals.items()}
        if "h" in document.data or "h" in values:
            drop_partner(document.data, values)
        for key in sorted(chosen.keys() - {*DRAWN}, key=lambda key: key.count(".")):  # sections before keys inside them
            set_key(document, tuple(key.split(".")), chosen[key], places.get(("grid", key), ""))
        _fit_step(document.data, self.spaced)

        # the states, which may need the top
        components = {key.removeprefix("initial."): column for key, column in columns.items() if key != "sample"}
        document.places |= {("initial", key): places.get(("grid", f"initial.{key}"), "") for key in components}
        samples, states = columns.get("sample", np.full(len(numbers), sample)), np.empty((0, 0))

        def start(top: Top, initial: object) -> Array:
            nonlocal states
            drawn = {"random": self.vectors, "samples": samples, "seed": seed}
            states = many_states(top, initial, document, columns=components, **drawn)
            return states

        experiment = read_experiment(document, self.name, start, [*components, *self.vectors])
        table = {
            key: columns[key].tolist() if key in columns else [_shown(key, values[key], experiment)] * len(numbers)
            for key in self.keys
        }
        return Group(experiment, states, numbers, table)

    @cached_property
    def _places(self) -> dict[KeyPath, str]:
        """Places of the keys of the base as keys of an experiment, and of the varied keys as keys of the grid."""
        places = {path[1:] if path[:1] == ("base",) else path: at for path, at in self.document.places.items()}
        zipped = {("grid", path[-1]): place for path, place in places.items() if path[:1] == ("zip",) and len(path) > 1}
        return zipped | places


def _size(axis: Axis) -> int:
    return len(next(iter(axis.values())))


def _kind(key: str) -> type:
    return int if key == "sample" else float


def _matches(axis: Axis, entry: Mapping[str, Any]) -> NDArray[np.bool_]:
    """True for each value of the axis that agrees with the keys of ``entry``."""
    rows = zip(*axis.values(), strict=True)
    return np.array([all(value == entry.get(key, value) for key, value in zip(axis, row, strict=True)) for row in rows])


def _varies_states(axis: Axis, samples: bool) -> bool:
    """True if an axis varies only numbers of components of the initial state, or ``samples``."""
    return all(
        (samples and key == "sample") or (key.startswith("initial.") and {*map(type, column)} <= {int, float})
        for key, column in axis.items()
    )


def _fit_step(data: dict[str, Any], spaced: bool) -> None:
    """Make h and N of T: h = T/N if h is missing, and of a ``spaced`` h the nearest that divides T."""
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
    return value if key.startswith("scheme.") or key in DRAWN else number_of(value)


def _flat(value: Any) -> str:
    return value if isinstance(value, str) else json.dumps(value)


def load_sweep(source: Path | str | Mapping[str, Any], overrides: Sequence[str] = ()) -> Sweep:
    """Load a sweep file (.yaml, .yml or .toml), a packaged sweep such as ``heavy_drift``, or a sweep given as a dict.

    ``overrides`` are ``key=value`` texts such as ``base.N=100``. Raises ConfigError or UnknownNameError with
    ``file:line``, the key, what is wrong and what would be right.
    """
    if isinstance(source, (str, os.PathLike)):
        path = find_config(source, sweep=True)
        document = read_document(path)
    else:
        path, document = Path("sweep"), Document(plain_data(source, Document({})))
    _expand_base(document, path.parent)
    apply_overrides(document, overrides)
    for section, inside in (("grid", ()), ("zip", ()), ("random", ("top",))):  # keys such as top.c0 in one piece
        raw = document.data.get(section)
        if isinstance(raw, dict):  # also where TOML or an override has made sections
            document.data[section] = flat = dict(_dotted(raw, inside))
            for key in flat:
                document.places.setdefault((section, key), document.place((section, *key.split("."))))
    data = {key: value for key, value in document.data.items() if value is not None}
    if "base" not in data and "top" in data:
        document.fault((), "this is an experiment; `topcli run` takes experiments, and a sweep has one in base")
    # the file, whose base is an experiment of which only some keys make sense
    file = document.read(SweepFile, data)
    name = data.get("name") or path.stem
    if "name" not in data and (fault := folder_name_fault(name)):
        document.fault(("name",), f"missing, and the file name cannot be used instead: {fault}")
    for key in UNFIT:  # which have no meaning in a sweep
        *sections, last = path = key.split(".")
        section = file.base.get(sections[0]) if sections else file.base
        if isinstance(section, dict) and section.get(last) is not None:
            document.fault(("base", *path), "cannot be in base: a row is one trajectory in doubles without a series")
    # the rows; defaults are written out, so that the digest does not depend on them
    axes, spaced = _read_axes(file, isinstance(data.get("zip"), list), document)
    varied, exclude = [key for axis in axes for key in axis], [dict(_dotted(entry)) for entry in file.exclude]
    for index, entry in enumerate(exclude):
        for key in (key for key in entry if key not in varied):
            document.fault(("exclude", index, key), f"does not vary; varied: {', '.join(varied)}")
    random = file.random and Random(**{k: v for k, v in file.random.items() if k in Random.model_fields}).model_dump()
    file = file.model_copy(update={"exclude": exclude, "random": {**file.random, **random}})
    intervals = {
        key: document.read(Interval, rule, "random", key) for key, rule in file.random.items() if key.startswith("top.")
    }
    sweep = Sweep(name, document, file, tuple(axes), spaced, intervals)
    if not axes:
        document.fault((), "varies nothing: give grid, zip or random; for example grid: {h: [0.1, 0.2]}")
    elif (count := math.prod(map(_size, axes))) > MAX_SWEEP_ROWS:
        document.fault((), f"{count} rows; a sweep has at most {MAX_SWEEP_ROWS}")
    elif not sweep.count_left:
        document.fault(("exclude",), "excludes every row, so the sweep would have none")
    return sweep


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


def _read_axes(file: SweepFile, listed: bool, document: Document) -> tuple[list[Axis], bool]:
    """Return the axes of the sections ``grid``, ``random`` and ``zip``, and True if the values of h are a range.

    ``listed`` says that ``zip`` is a list of sections.
    """
    # the sections in the order of their axes; the samples of random draws are one of them
    names, axes, spaced = [*_KEYS, *(DRAWN if file.random else ())], list[Axis](), False
    sections: list[tuple[KeyPath, dict[str, Any]]] = [(("grid",), {key: raw}) for key, raw in file.grid.items()]
    if file.random:
        numbers = {key: value for key, value in file.random.items() if key in Random.model_fields}
        random = document.read(Random, numbers, "random")
        if len(numbers) == len(file.random):
            document.fault(("random",), NOTHING_DRAWN)
        if "sample" not in file.grid:
            sections.append((("random",), {"sample": list(range(1, random.count + 1))}))
    sections += [(("zip", i) if listed else ("zip",), section) for i, section in enumerate(file.zip) if section]
    # keys of one section vary together, and those that every row draws cannot vary
    for path, section in sections:
        columns: dict[str, Sequence[Any]] = {}
        for key, raw in section.items():
            if key not in names and not key.startswith(("top.", "initial.", "scheme.")):
                document.fault((*path, key), unknown_key(key, names))
            if any(key in axis for axis in axes):
                document.fault((*path, key), "is varied twice; keep one of them")
            rule = file.random.get(drawn := key if key in file.random else key.removeprefix("initial."))
            centred = isinstance(rule, dict) and "near" in rule
            if rule is not None and drawn not in Random.model_fields and not centred:
                document.fault(("random", drawn), f"is drawn in every row, and {key} is varied; keep one of them")
            axis = read_axis(raw, document, *path, key)
            if isinstance(axis, Range):
                axis, spaced = axis.values(), spaced or key == "h"
                axis = list(dict.fromkeys(map(round, axis))) if key in (*DRAWN, "N", "output.every") else axis
            if key in DRAWN and not all(type(value) is int and value >= 0 for value in axis):
                document.fault((*path, key), "must be whole numbers from 0 on")
            columns[key] = axis
        if len({len(column) for column in columns.values()}) > 1:
            lengths = ", ".join(f"{key} has {len(column)}" for key, column in columns.items())
            document.fault(path, f"its lists must have equal lengths: {lengths}")
        axes.append(columns)
    return axes, spaced
