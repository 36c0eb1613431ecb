"""Rows of a sweep: the values of the varied keys in each row, and the experiment that they give.

A row is the base with its values laid over it. A million rows are read without a million validations: each distinct
top, scheme, initial state and set of steps is read once, by the functions that read a config, and kept with its
canonical JSON. Reading a row takes some microseconds, and the memory does not grow with the number of rows.

The seed of the draws of a row is the SHA-256 of the sweep's seed, the row's ``sample``, and the row's own top and
initial state as they are before the draw. It does not depend on the number of rows or on their order, so adding rows
changes no other row; and rows that differ in the scheme, in h or in N start from equal states, so schemes are compared
on the same motions.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from pydantic import BaseModel, ValidationError

from topcli.config.document import STRICT, Document, as_integer, describe
from topcli.config.draws import ABSOLUTE, first_drawn, random_model
from topcli.config.models import Count, Output, StepSize, canonical
from topcli.config.overrides import BARE
from topcli.config.ranges import duration_fault, steps_of
from topcli.config.sections import read_initial, read_scheme, read_top, top_with, vectors_of
from topcli.config.sweep import Assignment, Sweep
from topcli.config.text import KeyPath
from topcli.contracts import Top
from topcli.tops import TOPS

KEPT = 1 << 14
"""Sections of one kind that are kept; beyond it, the cache starts again."""
MAX_RECORDED = 10**8
"""Largest count of recorded states of a row."""


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
    quantities: str = ""
    """Canonical JSON of ``output.quantities``; empty without them."""

    @property
    def recorded(self) -> int:
        """Number of recorded states."""
        return self.N // self.every + 1

    def config(self, name: str) -> dict[str, Any]:
        """Return the row as a complete config."""
        return {
            "name": name,
            "top": json.loads(self.top),
            "initial": TOPS[self.form].initial_section(self.initial),
            "scheme": json.loads(self.scheme),
            "h": self.h,
            "N": self.N,
            "output": {
                "format": "parquet",
                "every": self.every,
                "columns": None,
                **({"quantities": json.loads(self.quantities)} if self.quantities else {}),
            },
        }


def scheme_label(section: dict[str, Any]) -> str:
    """Name of a scheme with the options that were given, such as ``hybrid:branch=sign``."""
    options = [f"{key}={json.dumps(value) if not isinstance(value, str) else value}" for key, value in section.items()]
    return ":".join([str(section["name"]), *(text for text in options if not text.startswith("name="))])


def row_seed(seed: int, sample: int, source: str) -> int:
    """Seed of a row, a number of 63 bits."""
    digest = hashlib.sha256(f"{seed},{sample},{source}".encode()).digest()
    return int.from_bytes(digest[:8], "big") >> 1


class _Part(NamedTuple):
    """A section of a row: what it was read as, its plain data, their canonical JSON, and its label."""

    value: Any
    plain: dict[str, Any]
    text: str
    label: str = ""


def _part(value: Any, plain: dict[str, Any], label: str = "") -> _Part:
    return _Part(value, plain, canonical(plain), label)


def _top_part(top: Top) -> _Part:
    return _part(top, top.section())


def _state_part(cls: type[Top], state: tuple[float, ...]) -> _Part:
    return _part(state, cls.initial_section(state))


class _Every(BaseModel):
    """Number of steps from one recorded state to the next."""

    model_config = STRICT

    every: Count = 1


class _Steps(BaseModel):
    """Keys of the steps of a row, of which T may take the place of h or N."""

    model_config = STRICT

    h: StepSize | None = None
    N: Count | None = None
    T: StepSize | None = None
    output: _Every = _Every()


SECTIONS = {key: key for key in ("top", "scheme", "initial")} | dict.fromkeys(("h", "N", "T", "output"), "steps")
"""Sections of a row by the first word of their keys."""


class RowReader:
    """Reader of the rows of a sweep, with the sections read so far in its cache.

    With ``labels_only`` the numbers, ``keys`` and drawn values of the rows are right, and what else costs time is left
    empty.
    """

    def __init__(self, sweep: Sweep, labels_only: bool = False) -> None:
        self.sweep = sweep
        parts = any(key.startswith(("initial.", "top.")) for key in sweep.keys)
        self._whole = not labels_only or parts or bool(sweep.drawn)
        self._paths: dict[str, list[tuple[int, list[str]]]] = {section: [] for section in SECTIONS.values()}
        for index, key in sorted(enumerate(sweep.keys), key=lambda item: item[1].count(".")):  # whole sections first
            if section := SECTIONS.get(key.partition(".")[0]):
                self._paths[section].append((index, key.split(".")))
        self._cache: dict[str, dict[Any, Any]] = {section: {} for section in self._paths}
        self._at = {key: index for index, key in enumerate(sweep.keys)}
        self._labels = [self._label(key) for key in sweep.keys]
        self._is_drawn = sweep.document.data.get("random") is not None
        initial = sweep.base.get("initial")
        self._vectors = [key for key in initial if key != "normalize"] if isinstance(initial, dict) else []
        self._vectors += [key for key in sweep.random if "." not in key and key not in ("count", "seed")]

    def rows(self) -> Iterator[Row]:
        """Yield the rows in order. Raises ConfigError or UnknownNameError with up to three faults."""
        document = replace(self.sweep.document, faults=[])
        for number, values in enumerate(self.sweep.assignments()):
            row = self.read(number, values, document)
            if row is not None:
                yield row
            elif len(document.faults) >= 3:
                break
        document.check()

    def row(self, number: int) -> Row | None:
        """Row ``number``; None if there is none."""
        for index, values in enumerate(self.sweep.assignments()):
            if index == number:
                document = replace(self.sweep.document, faults=[])
                row = self.read(number, values, document)
                document.check()
                return row
        return None

    def read(self, number: int, values: Assignment, document: Document) -> Row | None:
        """Read one row; None if it is wrong, which adds to ``document``."""
        own = _RowDocument(self.sweep, values)
        row = self._read(number, values, own)
        if row is None:
            for message in own.faults:
                if message not in document.faults:
                    document.faults.append(message)
        return row

    def _read(self, number: int, values: Assignment, document: Document) -> Row | None:
        named = tuple(path[1] for _, path in self._paths["initial"] if len(path) == 2)
        top = self._section("top", self._top, values, document, named)
        if top is None:
            return None
        cls = type(top.value)
        scheme = self._section("scheme", self._scheme, values, document, cls)
        steps = self._section("steps", self._steps, values, document, None)
        if scheme is None or steps is None:
            return None
        state = _Part((), {}, "")
        if self._whole:
            state = self._section("initial", self._initial, values, document, cls)
            if state is not None and self._is_drawn:
                top, state = self._drawn(values, top, state, document)
            if top is None or state is None:
                return None
        h, N, every = steps
        quantities = self._quantities(cls, document)
        if quantities is None:
            return None
        start = f'{state.text},"quantities":{quantities}' if quantities else state.text
        text = f'{{"N":{N},"every":{every},"h":{h!r},"initial":{start},"scheme":{scheme.text},"top":{top.text}}}'
        digest = hashlib.sha256(text.encode()).hexdigest() if self._whole else ""
        row = Row(number, digest, cls.form, top.text, scheme.text, state.value, h, N, every, (), quantities)
        return row._replace(keys=tuple([label(values, row, top, scheme) for label in self._labels]))

    def _section(
        self,
        section: str,
        read: Callable[[Assignment, Document, Any], Any],
        values: Assignment,
        document: Document,
        given: Any,
    ) -> Any:
        """Section of a row as ``read`` gives it, from the cache if its values have been read before."""
        kept = self._cache[section]
        key = (given, *[id(values[at]) for at, _ in self._paths[section]])
        part = kept.get(key)
        if part is None:
            part = read(values, document, given)
            if len(kept) >= KEPT:
                kept.clear()
            if part is not None:
                kept[key] = part
        return part

    def _value(self, key: str, values: Assignment, otherwise: Any) -> Any:
        """Value of a key in a row: its own, or ``otherwise``."""
        at = self._at.get(key)
        return otherwise if at is None else values[at]

    def _raw(self, section: str, values: Assignment) -> Any:
        """Section of a row as plain data: that of the base with the values of the row laid over it."""
        raw = self.sweep.base.get(section)
        for at, path in self._paths[section]:
            if len(path) == 1:
                raw = values[at]
                continue
            if not isinstance(raw, dict):
                raw = {} if raw is None else {BARE.get(section, ""): raw}
            value = values[at] if len(path) == 2 else {**(raw.get(path[1]) or {}), path[2]: values[at]}
            raw = {**raw, path[1]: value}
        return raw

    def _given(self, section: str, values: Assignment, document: Document) -> Any:
        """Section of a row as plain data; None, which is reported, if there is none."""
        raw = self._raw(section, values)
        if raw is None:
            document.fault((section,), "missing; give it in base, or vary it")
        return raw

    def _top(self, values: Assignment, document: Document, named: tuple[str, ...]) -> _Part | None:
        raw = self._given("top", values, document)
        if raw is None:
            return None
        _, top = read_top(raw, dict.fromkeys([*self._vectors, *named]), document)
        return None if top is None else _top_part(top)

    def _scheme(self, values: Assignment, document: Document, cls: type[Top]) -> _Part | None:
        raw = self._given("scheme", values, document)
        read = None if raw is None else read_scheme(raw, cls, document)
        if read is None:
            return None
        scheme, options = read
        hidden = {"name", "compose", *(path[1] for _, path in self._paths["scheme"] if len(path) == 2)}
        shown = {key: value for key, value in raw.items() if key not in hidden} if isinstance(raw, dict) else {}
        plain = {"name": scheme.name, **options.model_dump(mode="json")}
        return _part(scheme, plain, scheme_label({"name": scheme.name, **shown}))

    def _steps(self, values: Assignment, document: Document, _: None) -> tuple[float, int, int] | None:
        """h, N and output.every of a row."""
        base, before = self.sweep.base, len(document.faults)
        output = base.get("output") or {}
        if not isinstance(output, dict):
            document.fault(("output",), f"must be a section with keys, not {describe(output)}")
            return None
        for key, value in output.items():
            if key == "attitude" and value is not None:
                document.fault(("output", key), "a sweep records no attitude; run single rows with it")
            elif key not in ("every", "format", "columns", "quantities", "attitude"):
                document.fault(("output", key), "unknown key; only 'every' matters in a sweep")
        h = self._value("h", values, None)
        h = base.get("h") if h is None else h
        N, T = self._value("N", values, None), self._value("T", values, None)
        if N is None and T is None:  # one that varies replaces the other of the base
            N, T = base.get("N"), base.get("T")
        elif h is None and T is None:
            T = base.get("T")
        if (h is None) + (N is None) + (T is None) != 1:
            present = [key for key, value in (("h", h), ("N", N), ("T", T)) if value is not None]
            text = f"two of h, N and T are needed, but the row has {' and '.join(present) or 'none of them'}"
            document.fault((present[-1],) if present else (), text)
        if len(document.faults) > before:
            return None
        every = self._value("output.every", values, output.get("every", 1))
        given = {"h": h, "N": N, "T": T, "output": {"every": every}}
        try:  # without JSON, which takes longer than the rest
            steps: _Steps | None = _Steps.model_validate(given)
        except (ValidationError, OverflowError):
            steps = document.read(_Steps, given)
        if steps is None:
            return None
        h, N = self._from_duration(steps, document)
        every = steps.output.every
        if fault := duration_fault(h, N):
            document.fault(("N",), fault)
        elif every > N:
            document.fault(("output", "every"), f"must be at most N = {N}, not {every}")
        elif N // every >= MAX_RECORDED:
            text = f"records {N // every + 1} states of a row (at most {MAX_RECORDED}); record fewer"
            document.fault(("output", "every"), text)
        return (h, N, every) if len(document.faults) == before else None

    def _quantities(self, cls: type[Top], document: Document) -> str | None:
        """Canonical JSON of the quantities of rows with tops of class ``cls``, empty without any; None if wrong."""
        given = (self.sweep.base.get("output") or {}).get("quantities")
        if not given:
            return ""
        from topcli.config.formulas import read_quantities

        kept = self._cache.setdefault("quantities", {})
        if cls not in kept:
            before = len(document.faults)
            output = document.read(Output, {"quantities": given}, "output")
            formulas = read_quantities(output, cls, cls.new().invariants(), document) if output else None
            if len(document.faults) > before:
                return None
            kept[cls] = canonical(formulas)
        return kept[cls]

    def _from_duration(self, steps: _Steps, document: Document) -> tuple[float, int]:
        """h and N of a row. A step from a range becomes the nearest T/N."""
        h, N, T = steps.h, steps.N, steps.T
        if T is None or h is None:
            return (T or 0.0) / (N or 1) if h is None else h, N or 1
        if "h" in self.sweep.ranges and math.isfinite(T / h) and T / h >= 0.5:
            return T / round(T / h), round(T / h)
        with document.at("T"):
            return h, steps_of(T, h)
        return h, 1

    def _initial(self, values: Assignment, document: Document, cls: type[Top]) -> _Part | None:
        """Initial state of a row, or the centre of its draws."""
        free = {}
        if self._is_drawn:
            section = self._random(cls, document)
            if section is None:
                return None
            free = {draw.vector: [0.0, 0.0, 1.0] for draw in section.draws(cls) if draw.kind in ABSOLUTE}
        raw = self._raw("initial", values)
        made = dict(raw) if isinstance(raw, dict) else {} if raw is None else raw
        for vector in vectors_of(cls) if isinstance(raw, dict) else ():  # single components lie in their vectors
            single = {key: made.pop(key) for key in vector.components if key in made}
            if len(vector.components) == 1:  # it is a number
                made |= single
                continue
            base = made.get(
                vector.name, [0.0] * len(vector.components) if len(single) == len(vector.components) else None
            )
            if single and isinstance(base, list) and len(base) == len(vector.components):
                made[vector.name] = [single.get(*pair) for pair in zip(vector.components, base, strict=True)]
            elif single and not isinstance(base, list):
                text = f"missing; {next(iter(single))} is varied, and the other components need values"
                document.fault(("initial", vector.name), text)
                return None
        state = read_initial({**made, **free} if isinstance(made, dict) else made, cls, document)
        return None if state is None else _state_part(cls, state)

    def _random(self, cls: type[Top], document: Document) -> Any:
        """The section ``random`` for tops of class ``cls``; None if it is wrong."""
        kept = self._cache.setdefault("random", {})
        if cls not in kept:
            own = replace(self.sweep.document, faults=[])
            data = self.sweep.document.data["random"]
            section = own.read(random_model(cls, True), self.sweep.random if isinstance(data, dict) else data, "random")
            if section is not None and not (
                section.draws(cls) or section.model_dump(exclude={"count", "seed"}, exclude_none=True)
            ):
                example = ", ".join(f"{name}: {{near: 0.1}}" for name in cls.vectors)
                own.fault(("random",), f"nothing is random; for example random: {{count: 100, {example}}}")
            document.faults += own.faults
            if own.faults:
                return None
            kept[cls] = section
        return kept[cls]

    def _drawn(
        self, values: Assignment, top: _Part, centre: _Part, document: Document
    ) -> tuple[_Part | None, _Part | None]:
        """Top and initial state of a row whose parameters or vectors are drawn; None for what is wrong."""
        cls = type(top.value)
        section = self._random(cls, document)
        sample, seed = self._value("sample", values, 1), self._value("seed", values, section.seed)
        for key, value in (("sample", sample), ("seed", seed)):
            if not isinstance(as_integer(value), int) or isinstance(value, bool) or value < 0:
                document.fault((key,), f"must be a whole number, at least 0, not {describe(value)}")
                return None, None

        def seed_of(name: str) -> int:
            return row_seed(int(seed), int(sample), f"{name}{top.text}{centre.text}")

        chosen = {
            name: spread.value(np.random.Generator(np.random.PCG64(seed_of(name))).random())
            for name in cls.model_fields
            if (spread := getattr(section, f"top.{name}")) is not None
        }
        made: _Part | None = top
        if chosen:
            new = top_with(cls, {**top.value.model_dump(mode="json"), **chosen}, document)
            made = None if new is None else _top_part(new)
        if made is None or not (draws := section.draws(cls)):
            return made, centre
        state = first_drawn(made.value, np.array(centre.value), draws, seed_of(""))
        if state is None:
            document.fault(("random",), "no state has this energy: the potential energy alone exceeds it")
            return made, None
        return made, _state_part(cls, tuple(state.tolist()))

    def _label(self, key: str) -> Callable[[Assignment, Row, _Part, _Part], Any]:
        """Function that gives the value of a varied key as the results hold it."""
        first, _, inner = key.partition(".")
        at = self._at[key]
        labels: dict[str, Callable[[Assignment, Row, _Part, _Part], Any]] = {
            "h": lambda values, row, top, scheme: row.h,
            "N": lambda values, row, top, scheme: row.N,
            "T": lambda values, row, top, scheme: row.N * row.h if values[at] is None else float(values[at]),
            "output.every": lambda values, row, top, scheme: row.every,
            "scheme": lambda values, row, top, scheme: scheme.label,
            "top": lambda values, row, top, scheme: (
                top.value.kind if isinstance(values[at], str) else _shown(values[at])
            ),
            "scheme.": lambda values, row, top, scheme: _shown(scheme.plain.get(inner, values[at])),
            "top.": lambda values, row, top, scheme: _shown(
                type(top.value).parameters_in(top.plain).get(inner.removeprefix("parameters."))
            ),
            "initial.": lambda values, row, top, scheme: _component(inner, row, type(top.value), values[at]),
        }
        whole = key in ("sample", "seed")
        drawn = any(key in (name, name.rstrip("0123456789")) for name in self.sweep.drawn) and first == "initial"
        if whole or drawn:  # the centre of the draws
            return lambda values, row, top, scheme: int(values[at]) if whole else _shown(values[at])
        return labels.get(key) or labels[f"{first}."]


def _shown(value: Any) -> Any:
    """Value of a key in a column: numbers and text as they are, others as JSON; None for one that is absent."""
    if value is None:
        return None
    return value if isinstance(value, (str, int, float)) and not isinstance(value, bool) else json.dumps(value)


def _component(name: str, row: Row, cls: type[Top], given: Any) -> Any:
    """Component or vector of the initial state of a row."""
    if name in cls.components:
        return row.initial[cls.components.index(name)]
    if name in cls.vectors:
        return json.dumps(list(row.initial[slice(*cls.vectors[name])]))
    return _shown(given)


class _RowDocument(Document):
    """Places of the keys of one row: where the sweep file gives its values."""

    def __init__(self, sweep: Sweep, values: Assignment) -> None:
        super().__init__({})
        self._sweep, self._values = sweep, values

    def place(self, path: KeyPath) -> str:
        """Place of ``path`` in the sweep file, or of the section that holds it."""
        places, varied = self._sweep.document.places, dict(zip(self._sweep.keys, self._values, strict=True))
        keys = [".".join(map(str, path[:length])) for length in range(len(path), 0, -1)]
        if path and path[0] == "initial" and len(path) == 2:  # a component lies in its vector
            keys[1:1] = [key for key in varied if key.startswith(f"initial.{path[1]}")]
        for key in keys:
            if key not in varied:
                continue
            listed = [where for where in places if where[0:1] == ("zip",) and where[-1] == key]
            for where in (("grid", key), ("zip", key), ("random", "count"), *listed):
                if where in places:
                    return places[where]
        return self._sweep.document.place(("base", *path))
