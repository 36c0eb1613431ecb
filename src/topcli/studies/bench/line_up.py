"""The line-up of a benchmark: every scheme, with every option, that could be the fastest for some error."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Literal, get_args, get_origin

from pydantic import ValidationError

from topcli.contracts import Sampler, Scheme, Stepper
from topcli.errors import SchemeCodeError, UsageError
from topcli.schemes.registry import SchemeMisfitError, all_schemes, composable_names
from topcli.studies.bench.scenes import Problem
from topcli.studies.entries import scheme_with

COMPOSED = {
    "backlund": ("suzuki4", "kahan-li6", "kahan-li8"),
    "hk": ("kahan-li6", "kahan-li8"),
    "midpoint": ("kahan-li6", "kahan-li8"),
    "splitting": ("kahan-li6", "kahan-li8"),
}
"""Compositions that take part by default if their base fits."""


@dataclass(frozen=True)
class LineUp:
    """The ``schemes`` to measure, the ``exact`` solutions, and the schemes left out with the reasons."""

    schemes: tuple[Scheme, ...]
    exact: tuple[Scheme, ...]
    left_out: tuple[tuple[str, str], ...]


def _choices(annotation: Any) -> tuple[Any, ...]:
    """Values of an option that has only a few; empty for another."""
    return get_args(annotation) if get_origin(annotation) is Literal else ()


def order_settings(scheme: Scheme) -> Iterator[str]:
    """Yield the shortest ``option=value,...`` for each order of the scheme other than that of its defaults."""
    if scheme.order_with is None:
        return
    choices = {key: _choices(field.annotation) for key, field in scheme.options.model_fields.items()}
    seen = {scheme.order_for(scheme.options())}
    for count in range(1, len(choices) + 1):
        for keys in itertools.combinations(choices, count):
            for values in itertools.product(*(choices[key] for key in keys)):
                try:
                    order = scheme.order_for(scheme.options.model_validate(dict(zip(keys, values, strict=True))))
                except ValidationError:
                    continue
                if order not in seen:
                    seen.add(order)
                    yield ",".join(f"{key}={value}" for key, value in zip(keys, values, strict=True))


def default_names(form: str) -> list[str]:
    """Names of every scheme of a form of a top, of its other orders, and of the compositions of ``COMPOSED``."""
    schemes = [scheme for scheme in all_schemes() if scheme.top == form]
    composable = composable_names(form)
    return [
        *(scheme.name for scheme in schemes),
        *(f"{scheme.name}:{settings}" for scheme in schemes for settings in order_settings(scheme)),
        *(f"{base}+{name}" for base, names in COMPOSED.items() if base in composable for name in names),
    ]


def choose(problem: Problem, names: Sequence[str]) -> LineUp:
    """Return the schemes ``NAME[:option=value,...]`` that fit the problem's top; ``default_names`` if none is named.

    Left out are schemes that fit other tops only, that need options or equations that the top does not give, that are
    evaluated rather than stepped, and, by default, those that run in the interpreter. A scheme whose code raises takes
    part, so that its failure is reported. Raises UsageError for a scheme named twice, and UnknownNameError with the
    nearest names.
    """
    schemes: list[Scheme] = []
    exact: list[Scheme] = []
    left_out: list[tuple[str, str]] = []
    for name in names or default_names(problem.top.form):
        try:
            scheme = scheme_with(name, problem.top.form)
        except SchemeMisfitError:
            left_out.append((name, f"does not fit the top {problem.top.form}"))
            continue
        if any(scheme.name == other.name for other in (*schemes, *exact)):
            raise UsageError(f"scheme {scheme.name!r} is named twice")
        try:
            method = scheme.build(problem.top, scheme.options())
        except ValidationError as error:
            left_out.append((scheme.name, f"needs options ({error.errors()[0]['loc'][0]})"))
            continue
        except SchemeCodeError:
            schemes.append(scheme)
            continue
        except UsageError as error:
            left_out.append((scheme.name, str(error)))
            continue
        if isinstance(method, Sampler) and scheme.order is None:
            exact.append(scheme)
        elif isinstance(method, Sampler):
            left_out.append((scheme.name, "is evaluated, not stepped: its error is that of the scheme it solves"))
        elif isinstance(method, Stepper) and method.plain and not names:
            left_out.append(
                (scheme.name, "runs in the interpreter; the peer scipy is the same method and shows its cost")
            )
        else:
            schemes.append(scheme)
    return LineUp(tuple(schemes), tuple(exact), tuple(left_out))
