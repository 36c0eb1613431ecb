"""Rows of a sweep: what each computes, as plain data, read from the values of its varied keys.

A million rows are read without a million validations: each distinct top, scheme and initial state is validated once,
and its canonical JSON is kept; a row only checks what its sections have in common. Reading a row takes some
microseconds, and the memory does not grow with the number of rows.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeVar

from topcli.config.document import Document, KeyPath, describe
from topcli.config.models import as_integer, canonical, read_initial, read_scheme, read_top
from topcli.config.problems import Problems, validate
from topcli.config.sweep.document import MISSING, Assignment, Sweep
from topcli.config.sweep.draws import Drawer, read_drawer
from topcli.config.sweep.steps import StepReader
from topcli.contracts import Scheme, Top
from topcli.tops import TOPS

KEPT = 1 << 14
"""Validated sections of one kind that are kept; beyond it, the cache starts again."""
Part = TypeVar("Part")


class Row(NamedTuple):
    """Computation of a row, as plain data that can be sent to another process.

    ``top`` and ``scheme`` are canonical JSON of the resolved sections, ``form`` is the form of the top, and ``initial``
    the state in the order of its components; ``digest`` identifies all of it. ``keys`` are the values of the varied
    keys, for the results.
    """

    number: int
    digest: str
    form: str
    top: str
    scheme: str
    initial: tuple[float, ...]
    h: float
    N: int
    every: int
    keys: tuple[Any, ...]

    @property
    def recorded(self) -> int:
        """Number of recorded states."""
        return self.N // self.every + 1

    def config(self, name: str) -> dict[str, Any]:
        """Return the row as a complete config."""
        vectors = TOPS[self.form].vectors
        return {
            "name": name,
            "top": json.loads(self.top),
            "initial": {key: list(self.initial[start:stop]) for key, (start, stop) in vectors.items()},
            "scheme": json.loads(self.scheme),
            "h": self.h,
            "N": self.N,
            "output": {"format": "parquet", "every": self.every, "columns": None},
        }


def scheme_label(section: dict[str, Any]) -> str:
    """Name of a scheme with the options that were given, such as ``hybrid:branch=sign``."""
    options = [f"{key}={json.dumps(value) if not isinstance(value, str) else value}" for key, value in section.items()]
    return ":".join([str(section["name"]), *(text for text in options if not text.startswith("name="))])


@dataclass(frozen=True)
class _TopPart:
    cls: type[Top]
    top: Top
    text: str
    plain: dict[str, Any]


@dataclass(frozen=True)
class _SchemePart:
    scheme: Scheme
    text: str
    plain: dict[str, Any]
    label: str


@dataclass(frozen=True)
class _StatePart:
    state: tuple[float, ...]
    text: str


_NO_STATE = _StatePart((), "")


class RowReader:
    """Reader of the rows of a sweep, with the validated sections in its caches.

    With ``labels_only`` the numbers, ``keys`` and drawn values of the rows are right, and what else costs time is left
    empty.
    """

    def __init__(self, sweep: Sweep, labels_only: bool = False) -> None:
        self.sweep = sweep
        parts = any(key.startswith(("initial.", "top.")) for key in sweep.keys)
        self._whole = not labels_only or parts or bool(sweep.drawn)
        self._sections: dict[str, list[tuple[int, tuple[str, ...]]]] = {"top": [], "scheme": [], "initial": []}
        self._at = {key: index for index, key in enumerate(sweep.keys)}
        for index, key in enumerate(sweep.keys):
            first, *rest = key.split(".")
            if first in self._sections:
                self._sections[first].append((index, (first, *rest)))
        for found in self._sections.values():
            found.sort(key=lambda one: len(one[1]))  # whole sections before keys inside them
        self._parts: dict[str, dict[Any, Any]] = {name: {} for name in self._sections}
        self._vectors = [(index, path[1]) for index, path in self._sections["initial"] if len(path) == 2]
        self._label_of = [self._label(key) for key in sweep.keys]
        self._drawers: dict[type[Top], Drawer] = {}
        self._steps = StepReader(sweep)

    def rows(self) -> Iterator[Row]:
        """Yield the rows in order. Raises ConfigError or UnknownNameError with up to three faults."""
        problems = Problems(self.sweep.document)
        for number, values in enumerate(self.sweep.assignments()):
            row = self.read(number, values, problems)
            if row is not None:
                yield row
            elif len(problems.messages) >= 3:
                break
        problems.raise_any()

    def row(self, number: int) -> Row | None:
        """Row ``number``; None if there is none."""
        for index, values in enumerate(self.sweep.assignments()):
            if index == number:
                problems = Problems(self.sweep.document)
                found = self.read(number, values, problems)
                problems.raise_any()
                return found
        return None

    def read(self, number: int, values: Assignment, problems: Problems) -> Row | None:
        """Read one row; None if it is wrong, which adds to ``problems``."""
        own = Problems(_RowDocument(self.sweep, values))
        row = self._read(number, values, own)
        if row is None:
            for message in own.messages:
                if message not in problems.messages:
                    problems.messages.append(message)
                    problems.unknown_names += own.unknown_names == len(own.messages)
        return row

    def _read(self, number: int, values: Assignment, problems: Problems) -> Row | None:
        top = self._part("top", values, tuple(self._named(values)), lambda: self._top(values, problems))
        if top is None:
            return None
        cls = top.cls
        scheme = self._part("scheme", values, cls, lambda: self._scheme(values, cls, problems))
        steps = self._steps.read(values, problems)
        if scheme is None or steps is None:
            return None
        h, N, every = steps
        drawn = self.sweep.document.data.get("random")
        if not self._whole:
            state = _NO_STATE
        elif drawn is None:
            state = self._part("initial", values, top.cls, lambda: self._state(values, top, problems))
        else:
            made = self._drawn(values, top, problems)
            if made is None:
                return None
            top, state = made
        if state is None:
            return None
        text = f'{{"N":{N},"every":{every},"h":{h!r},"initial":{state.text},"scheme":{scheme.text},"top":{top.text}}}'
        digest = hashlib.sha256(text.encode()).hexdigest() if self._whole else ""
        row = Row(number, digest, top.cls.form, top.text, scheme.text, state.state, h, N, every, ())
        return row._replace(keys=tuple([label(values, row, top, scheme) for label in self._label_of]))

    def _part(self, section: str, values: Assignment, given: Any, read: Callable[[], Part | None]) -> Part | None:
        """Validated section, from the cache if its values have been read before."""
        parts = self._parts[section]
        key = (given, *[id(values[index]) for index, _ in self._sections[section]])
        found = parts.get(key)
        if found is None:
            found = read()
            if found is not None:
                if len(parts) >= KEPT:
                    parts.clear()
                parts[key] = found
        return found

    def _named(self, values: Assignment) -> list[str]:
        """Vectors that the initial state of a row names; they choose the form of the top."""
        initial = self.sweep.base.get("initial")
        names = [] if not isinstance(initial, dict) else [key for key in initial if key != "normalize"]
        names += [name for index, name in self._vectors if values[index] is not MISSING]
        drawn = self.sweep.document.data.get("random")
        if isinstance(drawn, dict):
            names += [key for key in drawn if "." not in key and key not in ("count", "seed")]
        return names

    def _raw(self, section: str, values: Assignment) -> Any:
        """Section of a row as plain data."""
        raw = self.sweep.base.get(section, MISSING)
        for index, path in self._sections[section]:
            value = values[index]
            if value is MISSING:
                continue
            if len(path) == 1:
                raw = value
            else:
                if not isinstance(raw, dict):
                    raw = {} if raw is MISSING else {{"top": "kind", "scheme": "name"}.get(section, ""): raw}
                raw = {**raw, path[1]: value}
        return raw

    def _top(self, values: Assignment, problems: Problems) -> _TopPart | None:
        raw = self._raw("top", values)
        if raw is MISSING:
            problems.add(("top",), "missing; give it in base, or vary it")
            return None
        cls, top = read_top(raw, dict.fromkeys(self._named(values)), problems)
        if cls is None or top is None:
            return None
        plain = {"kind": cls.kind, **top.model_dump(mode="json")}
        return _TopPart(cls, top, _top_text(cls, top), plain)

    def _scheme(self, values: Assignment, cls: type[Top], problems: Problems) -> _SchemePart | None:
        raw = self._raw("scheme", values)
        if raw is MISSING:
            problems.add(("scheme",), "missing; give it in base, or vary it")
            return None
        found = read_scheme(raw, cls, problems)
        if found is None:
            return None
        scheme, options = found
        plain = {"name": scheme.name, **options.model_dump(mode="json")}
        varied = {path[1] for index, path in self._sections["scheme"] if len(path) == 2}
        shown = {key: value for key, value in raw.items() if key not in varied} if isinstance(raw, dict) else {}
        shown = {key: value for key, value in shown.items() if key not in ("name", "compose")}
        return _SchemePart(scheme, canonical(plain), plain, scheme_label({"name": scheme.name, **shown}))

    def _state(self, values: Assignment, top: _TopPart, problems: Problems) -> _StatePart | None:
        raw = self.initial(values, top.cls, problems)
        state = None if raw is None else read_initial(raw, top.cls, problems)
        return None if state is None else _StatePart(state, _state_text(top.cls, state))

    def initial(self, values: Assignment, cls: type[Top], problems: Problems) -> dict[str, Any] | None:
        """Section ``initial`` of a row, with single components put into their vectors; None if that fails."""
        raw = self._raw("initial", values)
        if raw is MISSING:
            raw = {}
        if not isinstance(raw, dict):
            problems.add(("initial",), f"must be a section with {', '.join(cls.vectors)}, not {describe(raw)}")
            return None
        made = {key: value for key, value in raw.items() if key not in cls.components}
        for name, (start, stop) in cls.vectors.items():
            components = cls.components[start:stop]
            given = [component for component in components if component in raw]
            vector = made.get(name, [0.0] * len(components) if len(given) == len(components) else None)
            if not given or (isinstance(vector, list) and len(vector) != len(components)):
                continue
            if not isinstance(vector, list):
                problems.add(("initial", name), f"missing; {given[0]} is varied, and the others need a vector")
                return None
            made[name] = [
                raw[component] if component in given else value
                for component, value in zip(components, vector, strict=True)
            ]
        return made

    def _drawn(self, values: Assignment, top: _TopPart, problems: Problems) -> tuple[_TopPart, _StatePart] | None:
        """Top and initial state of a row whose parameters or vectors are drawn."""
        drawer = self._drawers.get(top.cls)
        if drawer is None:
            own = Problems(self.sweep.document)
            drawer = read_drawer(self.sweep.document.data["random"], top.cls, top.top, own)
            if drawer is None:
                problems.messages += own.messages
                return None
            self._drawers[top.cls] = drawer
        centre = self._part("initial", values, top.cls, lambda: self._centre(values, top, drawer, problems))
        if centre is None:
            return None
        sample, seed = self._steps.value("sample", values, 1), self._steps.value("seed", values, drawer.seed)
        for key, value in (("sample", sample), ("seed", seed)):
            if not isinstance(as_integer(value), int) or isinstance(value, bool) or value < 0:
                problems.add((key,), f"must be a whole number, at least 0, not {describe(value)}")
                return None
        source = f"{top.text}{centre.text}"
        cls, made = top.cls, top
        if drawer.spreads:
            chosen = drawer.parameters(int(seed), int(sample), source)
            new = validate(cls, {**top.top.model_dump(mode="json"), **chosen}, ("top",), problems)
            if new is None:
                return None
            made = _TopPart(cls, new, _top_text(cls, new), {"kind": cls.kind, **new.model_dump(mode="json")})
        if not drawer.draws:
            return made, centre
        state = drawer.state(made.top, centre.state, int(seed), int(sample), source)
        if state is None:
            problems.add(("random",), "no state has the energy: the potential alone exceeds it")
            return None
        return made, _StatePart(state, _state_text(cls, state))

    def _centre(self, values: Assignment, top: _TopPart, drawer: Drawer, problems: Problems) -> _StatePart | None:
        raw = self.initial(values, top.cls, problems)
        if raw is None:
            return None
        state = read_initial({**raw, **drawer.free}, top.cls, problems)
        return None if state is None else _StatePart(state, _state_text(top.cls, state))

    def _label(self, key: str) -> Callable[[Assignment, Row, _TopPart, _SchemePart], Any]:
        """Function that gives the value of a varied key as the results hold it."""
        first, *rest = key.split(".")
        at, inner = self._at[key], ".".join(rest)
        if key == "h":
            return lambda values, row, top, scheme: row.h
        if key == "N":
            return lambda values, row, top, scheme: row.N
        if key == "T":
            return lambda values, row, top, scheme: (
                row.N * row.h if values[at] in (MISSING, None) else float(values[at])
            )
        if key == "output.every":
            return lambda values, row, top, scheme: row.every
        if key in ("sample", "seed"):
            return lambda values, row, top, scheme: None if values[at] is MISSING else int(values[at])
        if key == "scheme":
            return lambda values, row, top, scheme: scheme.label
        if key == "top":
            return lambda values, row, top, scheme: top.cls.kind if isinstance(values[at], str) else _shown(values[at])
        if first == "scheme":
            return lambda values, row, top, scheme: _shown(scheme.plain.get(inner, values[at]))
        if first == "top":
            return lambda values, row, top, scheme: _shown(top.plain.get(inner))
        if any(key in (name, name.rstrip("0123456789")) for name in self.sweep.drawn):  # the centre of the draws
            return lambda values, row, top, scheme: _shown(values[at])
        return lambda values, row, top, scheme: _component(inner, row, top.cls, values[at])


def _shown(value: Any) -> Any:
    """Value of a key in a column: numbers and text as they are, others as JSON; None for one that is absent."""
    if value is MISSING or value is None:
        return None
    return value if isinstance(value, (str, int, float)) and not isinstance(value, bool) else json.dumps(value)


def _component(name: str, row: Row, cls: type[Top], given: Any) -> Any:
    """Component or vector of the initial state of a row."""
    if name in cls.components:
        return row.initial[cls.components.index(name)]
    if name in cls.vectors:
        return json.dumps(list(row.initial[slice(*cls.vectors[name])]))
    return _shown(given)


def _top_text(cls: type[Top], top: Top) -> str:
    """Canonical JSON of a top; forms of one kind differ in the vectors of the initial state."""
    return canonical({"kind": cls.kind, **top.model_dump(mode="json")})


def _state_text(cls: type[Top], state: tuple[float, ...]) -> str:
    """Canonical JSON of an initial state."""
    parts = (
        f'"{name}":[{",".join(map(repr, state[start:stop]))}]' for name, (start, stop) in sorted(cls.vectors.items())
    )
    return "{" + ",".join(parts) + "}"


class _RowDocument(Document):
    """Places of the keys of one row: where the sweep file gives its values."""

    def __init__(self, sweep: Sweep, values: Assignment) -> None:
        super().__init__({})
        self._sweep, self._values = sweep, values

    def place(self, path: KeyPath) -> str:
        """Place of ``path`` in the sweep file, or of the section that holds it."""
        document = self._sweep.document
        keys = [".".join(map(str, path[:length])) for length in range(len(path), 0, -1)]
        if path and path[0] == "initial" and len(path) == 2:  # a component lies in its vector
            keys[1:1] = [key for key in self._sweep.keys if key.startswith(f"initial.{path[1]}")]
        for key in keys:
            if key not in self._sweep.keys or self._values[self._sweep.keys.index(key)] is MISSING:
                continue
            for where in (("grid", key), ("zip", key), ("random", "count")):
                if where in document.places:
                    return document.places[where]
            for where, found in document.places.items():
                if where[0] in ("zip", "include") and where[-1] == key:
                    return found
        return document.place(("base", *path))
