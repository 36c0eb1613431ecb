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
from pydantic import BaseModel, BeforeValidator, Field, TypeAdapter

from topcli.config.document import STRICT, Document, canonical, number_of, plain, unknown_key
from topcli.config.files import find_config, read_document
from topcli.config.load import read_experiment
from topcli.config.models import Experiment, Name, name_fault
from topcli.config.overrides import apply_overrides, drop_partner, set_key
from topcli.config.ranges import MAX_STEPS, MAX_SWEEP_ROWS, Interval, Range, is_range, read_axis
from topcli.config.states import NOTHING_DRAWN, Random, Seed, drawn_number, many_states
from topcli.config.text import KeyPath, to_yaml
from topcli.contracts import Array, Top
from topcli.errors import UnknownNameError
from topcli.tops import TOPS

STEPS, DRAWN = ("h", "T", "N", "output.every"), ("sample", "seed")
"""Keys of the steps of a row, and of one that is drawn at random."""
KEYS = ("scheme", "top", "scheme.OPTION", "top.PARAMETER", "initial.VECTOR", "initial.COMPONENT", *STEPS)
UNFIT = ("name", "ensemble", "section", "precision", "max_digits", "output.columns", "output.attitude")
"""Keys of an experiment that a row of a sweep, one trajectory in doubles without a series, cannot have."""
CHUNK = 1 << 16
"""Most rows of a group; a larger one is yielded in parts."""
WHOLE: TypeAdapter[int] = TypeAdapter(Seed)

Sections = Annotated[list[dict[str, Any]], BeforeValidator(lambda raw: [raw] if isinstance(raw, dict) else raw)]


class SweepFile(BaseModel):
    """Content of a sweep file."""

    model_config = STRICT

    name: Name | None = None
    base: dict[str, Any] = Field(description="an experiment: its top, initial, scheme, h and N or T")
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

    The last of the ``axes`` varies fastest; rows that agree with an entry of ``file.exclude`` are left out. ``ranges``
    are the keys whose values are a range, and ``intervals`` the parameters that are drawn.
    """

    name: str
    document: Document
    file: SweepFile
    axes: tuple[Axis, ...]
    ranges: Mapping[str, Range]
    intervals: Mapping[str, Interval]

    @cached_property
    def keys(self) -> tuple[str, ...]:
        """Varied keys."""
        return tuple(key for axis in self.axes for key in axis)

    @property
    def log(self) -> list[str]:
        """Keys whose values are a logarithmic range."""
        return [key for key, values in self.ranges.items() if values.spacing == "log"]

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
            for start in range(0, len(rows), CHUNK):
                some = rows[start : start + CHUNK]
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
        _fit_step(document.data, "h" in self.ranges)

        # the states, which may need the top
        components = {key.removeprefix("initial."): column for key, column in columns.items() if key != "sample"}
        document.places |= {("initial", key): places.get(("grid", f"initial.{key}"), "") for key in components}
        samples, states = columns.get("sample", np.full(len(numbers), sample)), np.empty((0, 0))

        def start(top: Top, initial: object) -> Array | None:
            nonlocal states
            rows = many_states(
                top, initial, document, columns=components, random=self.vectors, samples=samples, seed=seed
            )
            states = states if rows is None else rows
            return rows

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
    if key == "scheme":
        options = value.items() if isinstance(value, dict) else ()
        texts = [(name, option if isinstance(option, str) else json.dumps(option)) for name, option in options]
        return ":".join([experiment.scheme.name, *(f"{a}={b}" for a, b in texts if a not in ("name", "compose"))])
    if key == "top" and isinstance(value, str):
        return experiment.top.kind
    if isinstance(value, str) or (number := number_of(value)) is None:
        return value if isinstance(value, str) else json.dumps(value)
    return value if key.startswith("scheme.") or key in DRAWN else number


def load_sweep(source: Path | str | Mapping[str, Any], overrides: Sequence[str] = ()) -> Sweep:
    """Load a sweep file (.yaml, .yml or .toml), a packaged sweep such as ``heavy_drift``, or a sweep given as a dict.

    ``overrides`` are ``key=value`` texts such as ``base.N=100``. Raises ConfigError or UnknownNameError with
    ``file:line``, the key, what is wrong and what would be right.
    """
    if isinstance(source, (str, os.PathLike)):
        path = find_config(source, sweep=True)
        document = read_document(path)
    else:
        path, document = Path("sweep"), Document(plain(source, Document({})))
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
        document.check()
    file = document.read(SweepFile, data)
    name = data.get("name") or path.stem
    if "name" not in data and (fault := name_fault(name)):
        document.fault(("name",), f"missing, and the file name cannot be used instead: {fault}")
    document.check()
    assert file is not None
    _check_base(file.base, document)
    axes, ranges = _read_axes(file, isinstance(data.get("zip"), list), document)
    document.check()
    entries = [dict(_dotted(entry)) for entry in file.exclude]
    fitting = [entry for entry in entries if _fits(entry, axes)]
    if len(fitting) < len(entries) and not overrides:  # which may have removed it
        index = next(i for i, entry in enumerate(entries) if entry not in fitting)
        document.fault(("exclude", index), f"no row has {entries[index]}")
    random = file.random and Random(**{k: v for k, v in file.random.items() if k in Random.model_fields}).model_dump()
    file = file.model_copy(update={"exclude": fitting, "random": {**file.random, **random}})
    parameters = [key for key in file.random if key.startswith("top.")]
    intervals = {
        key: interval for key in parameters if (interval := document.read(Interval, file.random[key], "random", key))
    }
    sweep = Sweep(name, document, file, tuple(axes), ranges, intervals)
    if not axes:
        document.fault((), "varies nothing: give grid, zip or random; for example grid: {h: [0.1, 0.2]}")
    elif (count := math.prod(map(_size, axes))) > MAX_SWEEP_ROWS:
        document.fault((), f"{count} rows; a sweep has at most {MAX_SWEEP_ROWS}")
    elif not sweep.count_left:
        document.fault(("exclude",), "excludes every row, so the sweep would have none")
    document.check()
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


def _check_base(base: dict[str, Any], document: Document) -> None:
    """Add a fault for each key of ``base`` that has no meaning in a sweep."""
    for key in UNFIT:
        *sections, last = path = key.split(".")
        section = base.get(sections[0]) if sections else base
        if isinstance(section, dict) and section.get(last) is not None:
            document.fault(("base", *path), "cannot be in base: a row is one trajectory in doubles without a series")


def _read_axes(file: SweepFile, listed: bool, document: Document) -> tuple[list[Axis], dict[str, Range]]:
    """Return the axes of the sections ``grid``, ``random`` and ``zip``, and the keys whose values are a range.

    ``listed`` says that ``zip`` is a list of sections.
    """
    known, axes, ranges = [*KEYS, *(DRAWN if file.random else ())], list[Axis](), dict[str, Range]()
    sections: list[tuple[KeyPath, dict[str, Any]]] = [(("grid",), {key: raw}) for key, raw in file.grid.items()]
    if file.random:
        numbers = {key: value for key, value in file.random.items() if key in Random.model_fields}
        random = document.read(Random, numbers, "random")
        if len(numbers) == len(file.random):
            document.fault(("random",), NOTHING_DRAWN)
        if random and "sample" not in file.grid:
            sections.append((("random",), {"sample": list(range(1, random.count + 1))}))
    sections += [(("zip", i) if listed else ("zip",), section) for i, section in enumerate(file.zip) if section]
    for path, section in sections:
        columns: dict[str, Sequence[Any]] = {}
        for key, raw in section.items():
            if key not in known and not key.startswith(("top.", "initial.", "scheme.")):
                document.fault((*path, key), unknown_key(key, known))
            if any(key in axis for axis in axes):
                document.fault((*path, key), "is varied twice; keep one of them")
            rule = key if key in file.random else key.removeprefix("initial.")
            centred = isinstance(file.random.get(rule), dict) and "near" in file.random[rule]
            if rule in file.random and rule not in Random.model_fields and not centred:
                document.fault(("random", rule), f"is drawn in every row, and {key} is varied; keep one of them")
            axis = read_axis(raw, document, *path, key) or []
            if isinstance(axis, Range):
                ranges[key], axis = axis, axis.values()
                if key in (*DRAWN, "N", "output.every"):  # whole numbers
                    axis = list(dict.fromkeys(map(round, axis)))
            with document.at(*path, key):
                columns[key] = [WHOLE.validate_python(value, strict=True) for value in axis] if key in DRAWN else axis
        if len({len(column) for column in columns.values()}) > 1:
            lengths = ", ".join(f"{key} has {len(column)}" for key, column in columns.items())
            document.fault(path, f"its lists must have equal lengths: {lengths}")
        axes.append(columns)
    return axes, ranges


def _fits(entry: Mapping[str, Any], axes: Sequence[Axis]) -> bool:
    """True if some row agrees with ``entry`` of ``exclude``."""
    return entry.keys() <= {key for axis in axes for key in axis} and all(_matches(axis, entry).any() for axis in axes)
