"""Entries of a comparison: schemes with their own options and step size, such as ``hybrid:branch=sign,h=0.01``.

All entries cover the same time. Entries with different steps are compared at times that all of them reach exactly.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from copy import copy
from dataclasses import dataclass, replace
from typing import Any

from pydantic import ValidationError, create_model

from topcli.config.document import describe, number_of
from topcli.config.load import load_experiment
from topcli.config.models import Experiment
from topcli.config.overrides import override_label, parse_override
from topcli.config.ranges import steps_of
from topcli.contracts import Scheme
from topcli.errors import SchemeCodeError, UnknownNameError, UsageError, nearest, printable, quoted, shortened
from topcli.schemes.plugins import users_error
from topcli.schemes.registry import find_scheme

STEP = "h"
"""Key of an entry's own step size; all other keys are options of its scheme."""
MAX_COMPARED_ROWS = 2_000_000
FEW_ROWS = 300
"""Entries have at least as many rows if the config asks for them and the numbers of steps allow it."""


@dataclass(frozen=True)
class Entry:
    """One column of a comparison.

    Attributes
    ----------
    label : str
        Name of the scheme and the entry's own settings; no two entries of a comparison have the same.
    own : tuple of str
        Keys of these settings.
    experiment : Experiment
        Experiment under this scheme and step; ``output.every`` divides ``stride``.
    stride : int
        Number of steps between compared rows.
    """

    label: str
    own: tuple[str, ...]
    experiment: Experiment
    stride: int

    @property
    def rows_apart(self) -> int:
        """Number of recorded rows from one compared row to the next."""
        return self.stride // self.experiment.output.every

    def settings(self) -> dict[str, Any]:
        """First figures of an entry: its label, scheme, options and steps; ``compared_every`` steps are compared."""
        experiment = self.experiment
        return {
            "label": self.label,
            "scheme": experiment.scheme.name,
            "options": experiment.options.model_dump(mode="json"),
            "changed": experiment.options.model_dump(mode="json", exclude_defaults=True),
            "own": list(self.own),
            "h": experiment.h,
            "N": experiment.N,
            "every": experiment.output.every,
            "compared_every": self.stride,
        }


def under_scheme(experiment: Experiment, name: str, options: Mapping[str, Any] | None = None) -> Experiment:
    """``experiment`` with another scheme, and with those of ``options`` that this scheme has.

    If it is the same scheme, composed or not, it keeps the other options of the experiment.
    """
    resolved = experiment.resolved()
    own = name.lower().partition("+")[0] == experiment.scheme.name.partition("+")[0]
    resolved["scheme"] = (resolved["scheme"] if own else {}) | {"name": name}
    known = find_scheme(name, experiment.top.form).options.model_fields
    resolved["scheme"] |= {key: value for key, value in (options or {}).items() if key in known}
    return load_experiment(resolved, any_precision=True)


def read_entries(
    experiment: Experiment, texts: Sequence[str], options: Mapping[str, Any] | None = None
) -> tuple[Entry, ...]:
    """Return the entries ``NAME[:key=value[,key=value]...]`` of a comparison.

    Parameters
    ----------
    experiment : Experiment
        Experiment that all entries share but for scheme, options, step size and recorded rows.
    texts : sequence of str
        Names of schemes, each with its own options and its own ``h``.
    options : mapping, optional
        Options of all schemes that have them; an entry's own options come first.

    Returns
    -------
    tuple of Entry
        If all have the ``h`` of the experiment, its rows are compared; otherwise common times, about as many.

    Raises
    ------
    UsageError
        For an unknown scheme or key, a step that does not divide the time, equal entries, or more rows than fit in
        memory. The message names the entry.
    """
    if experiment.output.attitude:
        raise UsageError("output.attitude: a comparison records no attitude; add --set output.attitude=null")
    entries = [_entry(experiment, text, options or {}) for text in texts]
    for key in options or ():
        if not any(key in entry.experiment.scheme.options.model_fields for entry in entries):
            known = {key for entry in entries for key in entry.experiment.scheme.options.model_fields}
            raise UsageError(f"--set scheme.{key}: none of the schemes has this option; {nearest(key, known)}")
    _require_different(entries)
    if any(entry.experiment.h != experiment.h for entry in entries):
        entries = _at_common_times(entries, max(1, experiment.N // experiment.output.every))
    rows = max(entry.experiment.N // entry.experiment.output.every + 1 for entry in entries)
    if rows > MAX_COMPARED_ROWS:
        raise UsageError(
            f"output.every: {rows} rows to compare in memory; "
            f"record fewer with --set output.every={experiment.N // MAX_COMPARED_ROWS + 1} or more"
        )
    return tuple(entries)


def scheme_options(overrides: Sequence[str]) -> tuple[dict[str, Any], list[str]]:
    """Options of ``scheme.KEY=VALUE`` for all schemes that have them, and the other overrides. Raises UsageError."""
    options, others = {}, []
    for text in overrides:
        path, value = parse_override(text)
        if path == ("scheme",):
            raise UsageError(f"{override_label(text)}: name the schemes as arguments of the command line")
        if path[0] == "scheme" and len(path) == 2 and path[1] != "name":
            options[path[1]] = value
        else:
            others.append(text)
    return options, others


def few_rows(entries: Sequence[Entry], experiment: Experiment) -> bool:
    """True if the entries share fewer times than ``experiment`` has rows, and fewer than ``FEW_ROWS``."""
    shared = entries[0].experiment.N // entries[0].stride
    return shared < min(FEW_ROWS, experiment.N // experiment.output.every)


@dataclass(frozen=True)
class Failed:
    """Entry whose code raised or could not be compiled."""

    label: str
    error: SchemeCodeError

    def as_dict(self) -> dict[str, str]:
        """Plain data, ready for JSON."""
        return {"label": self.label, "reason": str(self.error)}


@contextmanager
def users_code(failed: list[Failed], label: str) -> Iterator[None]:
    """Append to ``failed`` if the code of the entry ``label``, from a user's file or a plugin, fails within."""
    try:
        yield
    except Exception as error:
        known = error if isinstance(error, SchemeCodeError) else users_error(error)
        if known is None:
            raise
        failed.append(Failed(label, known))


def _entry(experiment: Experiment, text: str, options: Mapping[str, Any]) -> Entry:
    name, colon, settings = text.partition(":")
    with _named(text if colon else ""):
        scheme = find_scheme(name, experiment.top.form)
        own, shown = _settings(settings, scheme, (STEP,)) if colon else ({}, {})
        if STEP in own and experiment.written is not None:
            raise UsageError(f"entries share the step h at precision {experiment.precision}; give it with --set h=...")
        h = _step(own.pop(STEP), experiment.h) if STEP in own else experiment.h
        changed = under_scheme(experiment, name, {**options, **own})
        N = experiment.N if h == experiment.h else steps_of(experiment.duration, h, "h")
    if STEP in shown:
        shown[STEP] = f"{h:g}" if float(f"{h:g}") == h else repr(h)
    label = changed.scheme.name + (":" if shown else "") + ",".join(f"{key}={value}" for key, value in shown.items())
    every = experiment.output.every
    return Entry(printable(label), tuple(shown), changed.model_copy(update={"h": h, "N": N}), every)


@contextmanager
def _named(entry: str) -> Iterator[None]:
    """Let messages of errors begin with the ``entry``, unless that is empty."""
    try:
        yield
    except UsageError as error:
        if not entry:
            raise
        first, *others = error.lines
        raise type(error)(f"{shortened(entry)}: {first}", *others) from None


def scheme_with(text: str, form: str) -> Scheme:
    """Return the scheme ``NAME[:option=value,...]`` of a form of a top; the options given are its defaults.

    Raises UsageError for an unknown scheme or option, and for a value that the scheme refuses.
    """
    name, colon, settings = text.partition(":")
    scheme = find_scheme(name, form)
    if not colon:
        return scheme
    with _named(text):
        own, shown = _settings(settings, scheme)
        return with_defaults(scheme, own, ",".join(f"{key}={value}" for key, value in shown.items()))


def with_defaults(scheme: Scheme, values: Mapping[str, Any], shown: str) -> Scheme:
    """``scheme`` under the name ``scheme:shown``, with ``values`` as defaults of these options."""
    try:
        options = scheme.options.model_validate(values)
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"]) or shown
        raise UsageError(f"{key}: {first['msg'].removeprefix('Value error, ')}") from None
    fields: dict[str, Any] = {}
    for key in values:
        declared = copy(scheme.options.model_fields[key])
        declared.default = getattr(options, key)
        fields[key] = (declared.annotation, declared)
    return replace(
        scheme,
        name=f"{scheme.name}:{shown}",
        options=create_model(scheme.options.__name__, __base__=scheme.options, **fields),
        order=scheme.order_for(options),
        order_with=None,
    )


def _settings(text: str, scheme: Scheme, keys: tuple[str, ...] = ()) -> tuple[dict[str, Any], dict[str, str]]:
    """Values of ``key=value,...`` and their texts, by key: options of ``scheme``, or one of ``keys``."""
    values: dict[str, Any] = {}
    shown: dict[str, str] = {}
    for part in text.split(","):
        path, value = parse_override(part, quoted(part))
        key = ".".join(path)
        if key in values:
            raise UsageError(f"sets {key} twice; set it once")
        values[key], shown[key] = value, part.partition("=")[2].strip()
    known = (*keys, *scheme.options.model_fields)
    for key in values:
        if key not in known:
            raise UnknownNameError(f"scheme {scheme.name!r} has no option {quoted(key)}; {nearest(key, known)}")
    return values, shown


def _step(value: Any, base: float) -> float:
    """Step size of an entry, with the sign of that of the experiment."""
    h = number_of(value)
    if h is None or not math.isfinite(h) or h == 0.0:
        raise UsageError(f"h must be a finite number other than zero, not {describe(value)}")
    if (h > 0.0) != (base > 0.0):
        raise UsageError(f"h = {h:g} must have the sign of {base:g}, the step of the experiment")
    return h


def _require_different(entries: Sequence[Entry]) -> None:
    """Raise UsageError if two entries compute the same."""
    seen: dict[tuple[str, str, float], Entry] = {}
    for entry in entries:
        experiment = entry.experiment
        earlier = seen.setdefault((experiment.scheme.name, experiment.options.model_dump_json(), experiment.h), entry)
        if earlier is entry:
            continue
        if not (entry.own or earlier.own):
            raise UsageError(f"scheme {quoted(entry.label)} is named twice")
        if entry.label == earlier.label:
            raise UsageError(f"{entry.label} is named twice")
        raise UsageError(f"{entry.label}: computes the same as {earlier.label}; keep one of them")


def _at_common_times(entries: Sequence[Entry], wanted: int) -> list[Entry]:
    """Entries that record rows at common times, about ``wanted`` after time 0, and rows between if these are few."""
    least = min(FEW_ROWS, wanted)
    divisors = _divisors(math.gcd(*(entry.experiment.N for entry in entries)))
    count = max(divisor for divisor in divisors if divisor <= wanted)
    if count < least:
        count = min((divisor for divisor in divisors if divisor >= least), default=count)
    aligned = []
    for entry in entries:
        N = entry.experiment.N
        stride = every = N // count
        if count < least:
            between = [every for every in _divisors(stride) if min(least, N) <= N // every < MAX_COMPARED_ROWS]
            every = max(between, default=stride)
        output = entry.experiment.output.model_copy(update={"every": every})
        aligned.append(replace(entry, stride=stride, experiment=entry.experiment.model_copy(update={"output": output})))
    return aligned


def _divisors(number: int) -> list[int]:
    low = [divisor for divisor in range(1, math.isqrt(number) + 1) if number % divisor == 0]
    return low + [number // divisor for divisor in low]
