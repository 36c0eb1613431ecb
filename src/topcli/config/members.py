"""Reading the section ``ensemble`` of a config: initial states from a list, a grid, or seeded random draws."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from topcli.config.document import Document, KeyPath, describe
from topcli.config.ensemble import (
    MAX_TRAJECTORIES,
    Combined,
    Draw,
    Drawn,
    Group,
    Listed,
    Members,
    Random,
    Section,
    Spaced,
    draw_examples,
    energy_fault,
)
from topcli.config.models import number_of, read_initial, read_vector
from topcli.config.problems import Problems, unknown_key, validate
from topcli.contracts import Top

SOURCES = ("states", "grid", "random")
ABSOLUTE = ("sphere", "energy")
"""Draws that need no initial vector to start from."""


def vectors_named(raw: object) -> list[str]:
    """Vectors that the section names, valid or not; they help to choose the form of the top."""
    if not isinstance(raw, dict):
        return []
    drawn = raw["random"] if isinstance(raw.get("random"), dict) else {}
    listed = raw["states"] if isinstance(raw.get("states"), list) else []
    named = [key for key in drawn if key not in Random.model_fields]
    return named + [key for state in listed if isinstance(state, dict) for key in state if key != "normalize"]


def read_members(
    raw: object, initial: object, cls: type[Top], top: Top, parameters: Mapping[str, Any], problems: Problems
) -> Members | None:
    """Return the initial states of an ensemble of ``top``; None if the section or ``initial`` is wrong.

    ``parameters`` are the parameters of the top as the config gives them, for a grid over some of them.
    """
    path: KeyPath = ("ensemble",)
    if not isinstance(raw, dict):
        problems.add(path, f"must be a section with one of {', '.join(SOURCES)}, not {describe(raw)}; {_example(cls)}")
        return None
    section = validate(Section, raw, path, problems)
    given = [key for key in SOURCES if raw.get(key) is not None]
    if len(given) != 1:
        found_text = f"has {' and '.join(given)}" if given else "has none of them"
        problems.add(path, f"must have one of {', '.join(SOURCES)}, and {found_text}; {_example(cls)}")
        return None
    if not isinstance(initial, dict):
        problems.add(("initial",), f"must be a section with {', '.join(cls.vectors)}, not {describe(initial)}")
        return None
    source = given[0]
    found: tuple[tuple[Group, ...], Any] | None
    if source == "states":
        found = _listed(raw[source], initial, cls, top, problems)
    elif source == "grid":
        found = _gridded(raw[source], initial, cls, parameters, problems)
    else:
        found = _drawn(raw[source], initial, cls, top, problems)
    if found is None or section is None:
        return None
    kept = {key: _floats(value) for key, value in initial.items()}
    for key, value in kept.items():  # a trajectory may replace any of them
        for item in value if isinstance(value, list) else [value]:
            if isinstance(item, float) and not math.isfinite(item):
                problems.add(("initial", key), f"must hold finite numbers, not {item!r}")
                return None
    return Members(found[0], {source: found[1], "store": section.store}, kept)


def _example(cls: type[Top], source: str = "random") -> str:
    """End of a message: an example of a ``source`` of initial states."""
    first = next(iter(cls.vectors))
    if source == "states":
        return f"for example [{{{first}: [1, 0, 0]}}, {{{first}: [0, 1, 0]}}]"
    if source == "grid":
        return f"for example {{{cls.components[0]}: {{start: 0, stop: 1, count: 11}}}}"
    drawn = ", ".join(f"{name}: {draw_examples(cls, name)[0]}" for name in cls.vectors)
    return f"for example random: {{count: 100, {drawn}}}"


def _draw_forms(cls: type[Top], name: str) -> str:
    """Examples of the ways to draw the vector ``name``."""
    *others, last = [f"{name}: {example}" for example in draw_examples(cls, name)]
    return f"{', '.join(others)} or {last}"


def _floats(value: Any) -> Any:
    """Return plain data with whole numbers as floats."""
    if isinstance(value, list):
        return [_floats(item) for item in value]
    number = number_of(value)
    return value if number is None else number


def _listed(
    raw: object, initial: dict[str, Any], cls: type[Top], top: Top, problems: Problems
) -> tuple[tuple[Group, ...], Any] | None:
    path: KeyPath = ("ensemble", "states")
    if not isinstance(raw, list) or not raw:
        problems.add(
            path,
            f"must be a list of initial states, not {describe(raw) if raw != [] else 'an empty one'}; "
            + _example(cls, "states"),
        )
        return None
    states = []
    for index, given in enumerate(raw):
        if not isinstance(given, dict):
            vectors = ", ".join(cls.vectors)
            problems.add((*path, index), f"must be a section with {vectors}, not {describe(given)}")
            continue
        state = _state({**initial, **given}, cls, (*path, index), problems)
        if state is not None:
            states.append(state)
    if len(states) < len(raw):
        return None
    kept = [{key: _floats(value) for key, value in given.items()} for given in raw]
    return (Group(top, Listed(np.array(states))),), kept


def _state(raw: dict[str, Any], cls: type[Top], path: KeyPath, problems: Problems) -> tuple[float, ...] | None:
    """Return an initial state, with its mistakes reported at ``path``."""
    own = Problems(Document({}))
    state = read_initial(raw, cls, own)
    for message in own.messages:
        problems.add(path, message.removeprefix("initial."))
    return state


def _gridded(
    raw: object, initial: dict[str, Any], cls: type[Top], parameters: Mapping[str, Any], problems: Problems
) -> tuple[tuple[Group, ...], Any] | None:
    """Return the product of the axes: parameters vary slowest, then the components in their order, the last fastest."""
    path: KeyPath = ("ensemble", "grid")
    order = [*(f"top.{name}" for name in cls.model_fields), *cls.components]
    known = [*cls.components, *order[: -len(cls.components)]]
    if not isinstance(raw, dict) or not raw:
        given = describe(raw) if raw != {} else "an empty one"
        problems.add(path, f"must be a section with some of {', '.join(known)}, not {given}; {_example(cls, 'grid')}")
        return None
    axes: dict[str, list[float]] = {}
    kept: dict[str, Any] = {}
    for key in sorted(raw, key=lambda key: order.index(key) if key in order else -1):
        if key not in known:
            problems.add((*path, key), unknown_key(key, known))
            continue
        values = _axis(raw[key], (*path, key), problems)
        if values is not None:
            axes[key], kept[key] = values
    if len(axes) < len(raw):
        return None
    total = math.prod(len(values) for values in axes.values())
    if total > MAX_TRAJECTORIES:
        problems.add(path, f"{total} combinations; an ensemble has at most {MAX_TRAJECTORIES} trajectories")
        return None
    states = _combined(axes, initial, cls, path, problems)
    named = [key for key in axes if key.startswith("top.")]
    tops = []
    for values in itertools.product(*(axes[key] for key in named)):
        chosen = dict(zip((key.removeprefix("top.") for key in named), values, strict=True))
        own = Problems(Document({}))
        top = validate(cls, {**parameters, **chosen}, ("top",), own, beside=("kind",))
        for message in own.messages:
            at = ", ".join(f"{name} = {value!r}" for name, value in chosen.items())
            problems.add(path, f"at {at}: {message}" if at else message)
        tops.append(top)
    if states is None or None in tops:
        return None
    return tuple(Group(top, states) for top in tops), kept


def _axis(raw: object, path: KeyPath, problems: Problems) -> tuple[list[float], Any] | None:
    """Return the values of an axis, and the axis as plain data with its defaults."""
    if isinstance(raw, dict):
        spaced = validate(Spaced, raw, path, problems)
        return None if spaced is None else (spaced.values(), spaced.model_dump())
    if not isinstance(raw, list) or not raw:
        given = describe(raw) if raw != [] else "an empty list"
        problems.add(
            path,
            f"must be a list of numbers, or a section with start, stop and count, not {given}; "
            "for example [0.1, 0.2] or {start: 0, stop: 1, count: 11}",
        )
        return None
    numbers = [number_of(value) for value in raw]
    for value, number in zip(raw, numbers, strict=True):
        if number is None or not math.isfinite(number):
            problems.add(path, f"must hold finite numbers, not {describe(value)}")
            return None
    values = [number for number in numbers if number is not None]
    return values, values


def _combined(
    axes: Mapping[str, list[float]], initial: dict[str, Any], cls: type[Top], path: KeyPath, problems: Problems
) -> Combined | None:
    """Return every combination of the components' values, the vectors completed as ``initial`` asks for."""
    before = len(problems.messages)
    for key in initial:
        if key not in (*cls.vectors, "normalize"):
            problems.add(("initial", key), unknown_key(key, [*cls.vectors, "normalize"]))
    if not isinstance(normalize := initial.get("normalize", False), bool):
        problems.add(("initial", "normalize"), f"must be true or false, not {describe(normalize)}")
        return None
    pieces = []
    for name, (start, stop) in cls.vectors.items():
        components = cls.components[start:stop]
        varied = [component for component in components if component in axes]
        base = initial.get(name)
        if base is None and len(varied) == len(components):
            base = [0.0] * len(components)
        if not isinstance(base, list) or len(base) != len(components):
            if name not in initial:
                problems.add(("initial", name), f"missing; give a list of {len(components)} numbers")
            else:
                read_vector(base, cls, name, normalize, problems)
            continue
        vectors = np.empty((math.prod(len(axes[component]) for component in varied), len(components)))
        for row, values in enumerate(itertools.product(*(axes[component] for component in varied))):
            raw = list(base)
            for component, value in zip(varied, values, strict=True):
                raw[components.index(component)] = value
            own = Problems(Document({}))
            vector = read_vector(raw, cls, name, normalize, own)
            if vector is None:
                at = ", ".join(f"{one} = {value!r}" for one, value in zip(varied, values, strict=True))
                where: KeyPath = path if at else ("initial", name)
                for message in own.messages:
                    text = message.removeprefix(f"initial.{name}: ")
                    problems.add(where, f"at {at}: {name}: {text}" if at else text)
                break
            vectors[row] = vector
        pieces.append(vectors)
    if len(problems.messages) > before:
        return None
    return Combined(tuple(pieces))


def _drawn(
    raw: object, initial: dict[str, Any], cls: type[Top], top: Top, problems: Problems
) -> tuple[tuple[Group, ...], Any] | None:
    path: KeyPath = ("ensemble", "random")
    if not isinstance(raw, dict):
        problems.add(path, f"must be a section with count and vectors, not {describe(raw)}; {_example(cls)}")
        return None
    spec = validate(Random, raw, path, problems, beside=cls.vectors)
    draws = [read_draw(raw[name], cls, top, (*path, name), problems) for name in cls.vectors if name in raw]
    if not draws:
        problems.add(path, f"no vector is random; {_example(cls)}")
        return None
    chosen = tuple(draw for draw in draws if draw is not None)
    if spec is None or len(chosen) < len(draws):
        return None
    free = {draw.vector: [0.0, 0.0, 1.0] for draw in chosen if draw.kind in ABSOLUTE}
    centre = read_initial({**initial, **free}, cls, problems)
    if centre is None:
        return None
    drawn = Drawn(top, np.array(centre), chosen, spec.count, spec.seed)
    if next(drawn.blocks(1), None) is None:
        energy = next(draw for draw in chosen if draw.kind == "energy")
        problems.add(
            (*path, energy.vector, "energy"), f"no state has the energy {energy.size!r}: the potential alone exceeds it"
        )
        return None
    kept = {**spec.model_dump(), **{draw.vector: {draw.kind: draw.size} for draw in chosen}}
    return (Group(top, drawn),), kept


def read_draw(raw: object, cls: type[Top], top: Top, path: KeyPath, problems: Problems) -> Draw | None:
    """Return the rule to draw the vector that ends ``path``; None if it is wrong."""
    name = str(path[-1])
    unit = name in cls.unit_vectors
    kinds = ["sphere", "near"] if unit else ["sphere", "near", "energy"]
    start, stop = cls.vectors[name]
    if stop - start != 3:
        problems.add(path, "cannot be drawn: it is not a vector of three components")
        return None
    if raw == "sphere" and unit:
        return Draw(name, "sphere", 1.0)
    if isinstance(raw, str) or not isinstance(raw, dict):
        problems.add(path, f"{describe(raw)} does not say how to draw it; write {_draw_forms(cls, name)}")
        return None
    for key in raw:
        if key not in kinds:
            problems.add((*path, key), f"{unknown_key(key, kinds)} (write {_draw_forms(cls, name)})")
            return None
    if len(raw) != 1:
        problems.add(
            path, f"must have one of {', '.join(kinds)}, not {len(raw)} of them; write {_draw_forms(cls, name)}"
        )
        return None
    ((kind, value),) = raw.items()
    size = number_of(value)
    if size is None or not math.isfinite(size):
        problems.add((*path, kind), f"must be a finite number, not {describe(value)}; write {_draw_forms(cls, name)}")
        return None
    if kind == "energy" and (fault := energy_fault(top, name)):
        problems.add((*path, kind), fault)
        return None
    if kind != "energy" and not size > 0.0:
        problems.add((*path, kind), f"must be greater than 0, not {describe(value)}")
        return None
    if unit and ((kind == "sphere" and size != 1.0) or size > math.pi):
        most = "1, because the vector is a unit vector" if kind == "sphere" else "an angle of at most pi"
        problems.add((*path, kind), f"must be {most}, not {describe(value)}")
        return None
    return Draw(name, kind, size)
