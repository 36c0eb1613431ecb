"""Subjects of a benchmark: problems, participating schemes, and their settings from coarse to fine."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal, get_args, get_origin

import numpy as np
from pydantic import BaseModel, ValidationError

from topcli.config.load import load_experiment
from topcli.config.models import Experiment
from topcli.contracts import Array, Sampler, Scheme, Stepper, Top
from topcli.errors import SchemeCodeError, UnknownNameError, UsageError, nearest, quoted
from topcli.schemes.registry import SchemeMisfitError, composable_names, schemes_of
from topcli.studies.entries import scheme_with
from topcli.tops import TOPS

BENCH_INTERVALS = 100
"""Number of intervals between the evenly spaced times at which errors are measured."""


@dataclass(frozen=True)
class Scene:
    """A packaged ``config`` run for ``duration``; ``goal`` is the speed to reach, as a multiple of the best peer's."""

    name: str
    title: str
    config: str
    duration: float
    goal: float


SCENES: dict[str, Scene] = {
    scene.name: scene
    for scene in (
        Scene("kowalevski-generic", "Kowalevski top, generic", "kowalevski_generic_hk", 1000.0, 2.0),
        Scene("kowalevski-paper", "Kowalevski top, near the homoclinic orbit", "kowalevski_hk", 50.0, 1.5),
        Scene("euler", "Euler top", "euler_hk", 100.0, 1.5),
        Scene("lagrange", "Lagrange top", "lagrange_hk", 100.0, 1.5),
    )
}


@dataclass(frozen=True)
class Problem:
    """The problem to solve: the motion of a config's top for ``duration``, compared at ``intervals`` + 1 times."""

    name: str
    title: str
    experiment: Experiment
    duration: float
    intervals: int
    goal: float | None = None

    @property
    def top(self) -> Top:
        """Top of the experiment."""
        return self.experiment.top

    @property
    def interval(self) -> float:
        """Time between two comparisons."""
        return self.duration / self.intervals

    @property
    def times(self) -> Array:
        """Times of the comparisons, from zero, shape (intervals + 1,)."""
        return np.arange(self.intervals + 1) * self.interval


def bench_problems(
    scenes: Sequence[str], configs: Sequence[str], sets: Sequence[str] = (), intervals: int = BENCH_INTERVALS
) -> list[Problem]:
    """Return the problems of the named ``scenes`` and of ``configs``; of all scenes if neither is given.

    A config gives its top, its initial state and its duration N*h; ``sets`` are overrides of configs. Raises
    UnknownNameError with the nearest names, and UsageError for a name given twice or a run backwards in time.
    """
    if sets and not configs:
        raise UsageError("--set changes a --config, and none is given; scenes cannot be changed")
    names = list(scenes) if scenes or configs else list(SCENES)
    problems = []
    for name in names:
        scene = SCENES.get(name.lower().replace("_", "-"))
        if scene is None:
            raise UnknownNameError(f"--scene: unknown scene {quoted(name)}; {nearest(name, SCENES)}")
        experiment = load_experiment(scene.config)
        problems.append(Problem(scene.name, scene.title, experiment, scene.duration, intervals, scene.goal))
    for config in configs:
        experiment = load_experiment(config, sets)
        if experiment.duration < 0.0:
            raise UsageError(f"--config {config}: h = {experiment.h:g} runs backwards; speed is measured forwards")
        problems.append(Problem(experiment.name, experiment.top.title, experiment, experiment.duration, intervals))
    named = [problem.name for problem in problems]
    if repeated := sorted({name for name in named if named.count(name) > 1}):
        raise UsageError(f"scene {repeated[0]!r} is named twice")
    return problems


TOLERANCES = ("tol", "rtol")
"""The ladder of an adaptive scheme varies the first of these options that it has, and ``atol`` in proportion."""
FIRST_TOLERANCE, LAST_TOLERANCE = 1e-2, 1e-18
RUNGS = 60
"""Largest number of rungs; a budget or round-off ends a ladder long before."""


@dataclass(frozen=True)
class Rung:
    """One setting: the ``value`` of h or of the tolerance, as ``steps`` in each interval and the ``options``."""

    value: float
    steps: int = 1
    options: tuple[tuple[str, float], ...] = ()


def _limits(model: type[BaseModel], key: str) -> tuple[float, float]:
    """Return the smallest and largest value that the declaration of an option allows."""
    low, high = 0.0, math.inf
    for constraint in model.model_fields[key].metadata:
        low = max(low, getattr(constraint, "ge", None) or 0.0, math.nextafter(getattr(constraint, "gt", None) or 0, 1))
        for name in ("le", "lt"):
            limit = getattr(constraint, name, None)
            high = high if limit is None else min(high, limit if name == "le" else math.nextafter(limit, 0))
    return low, high


def tolerance_option(scheme: Scheme) -> str | None:
    """Return the option that the ladder of an adaptive scheme varies; None for a scheme of fixed steps.

    Raises UsageError for an adaptive scheme without such an option.
    """
    if not scheme.adaptive:
        return None
    for name in TOLERANCES:
        if name in scheme.options.model_fields:
            return name
    raise UsageError(
        f"scheme {scheme.name!r} is adaptive and has no option {' or '.join(TOLERANCES)} to measure it over"
    )


def _tolerance_ladder(scheme: Scheme, name: str) -> Iterator[Rung]:
    """Yield half decades of the tolerance within its limits, and its smallest value."""
    low, high = _limits(scheme.options, name)
    least = max(low, LAST_TOLERANCE)
    values = [float(f"{mantissa}e{e}") for e in range(0, -400, -1) for mantissa in ("1", "0.32")]
    values = [v for v in values if least * (1.0 + 1e-9) < v <= min(high, FIRST_TOLERANCE)]
    fields = scheme.options.model_fields
    for value in [*values, least]:
        options = [(name, value)]
        if "atol" in fields and isinstance(fields["atol"].default, float) and isinstance(fields[name].default, float):
            lowest, highest = _limits(scheme.options, "atol")
            scaled = value * fields["atol"].default / fields[name].default
            options.append(("atol", min(max(scaled, lowest), highest)))
        yield Rung(value, 1, tuple(options))


def _step_ladder(order: int | None, y0: Array, interval: float) -> Iterator[Rung]:
    """Yield finer and finer steps that divide the interval, by a factor 2 up to order 2 and otherwise sqrt(2).

    The first is about four over the largest component of the state, an angle of four radians per step; nobody needs a
    coarser one.
    """
    ratio = 2.0 if order is not None and order <= 2 else math.sqrt(2.0)
    size = max(float(max(abs(y) for y in y0)), 1e-300)
    first = max(1.0, math.ceil(0.25 * interval * size))
    before = 0
    for k in range(RUNGS):
        steps = round(first * ratio**k)
        if steps > before and steps * interval < 2.0**52:
            yield Rung(interval / steps, steps)
            before = steps


def ladder(scheme: Scheme, y0: Array, interval: float) -> Iterator[Rung]:
    """Yield the rungs of ``scheme``, coarse to fine, from the state ``y0`` with a comparison every ``interval``.

    Steps h for a scheme of fixed steps; half decades of its tolerance for an adaptive one. Raises UsageError for an
    adaptive scheme that has none.
    """
    name = tolerance_option(scheme)
    if name is not None:
        return _tolerance_ladder(scheme, name)
    return _step_ladder(scheme.order, y0, interval)


COMPOSED = {
    "backlund": ("suzuki4", "kahan-li6", "kahan-li8"),
    "hk": ("kahan-li6", "kahan-li8"),
    "midpoint": ("kahan-li6", "kahan-li8"),
    "splitting": ("kahan-li6", "kahan-li8"),
}
"""Compositions that take part by default if their base fits."""


@dataclass(frozen=True)
class LineUp:
    """The ``schemes`` to measure, the ``closed_forms``, and the schemes left out with the reasons."""

    schemes: tuple[Scheme, ...]
    closed_forms: tuple[Scheme, ...]
    left_out: tuple[tuple[str, str], ...]


def order_settings(scheme: Scheme) -> Iterator[str]:
    """Yield the shortest ``option=value,...`` for each order of the scheme other than that of its defaults."""
    if scheme.order_with is None:
        return
    annotations = {key: field.annotation for key, field in scheme.options.model_fields.items()}
    choices = {key: get_args(kind) for key, kind in annotations.items() if get_origin(kind) is Literal}
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
    schemes = schemes_of(form)
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
    closed_forms: list[Scheme] = []
    left_out: list[tuple[str, str]] = []
    for name in names or default_names(problem.top.form):
        try:
            scheme = scheme_with(name, problem.top.form)
        except SchemeMisfitError:
            left_out.append((name, f"does not fit the top {TOPS.called(problem.top.form)}"))
            continue
        if any(scheme.name == other.name for other in (*schemes, *closed_forms)):
            raise UsageError(f"scheme {scheme.name!r} is named twice")
        reason = ""
        try:
            method = scheme.build(problem.top, scheme.options())
        except ValidationError as error:
            reason = f"needs options ({error.errors()[0]['loc'][0]})"
        except SchemeCodeError:
            schemes.append(scheme)
            continue
        except UsageError as error:
            reason = str(error)
        else:
            if isinstance(method, Sampler) and scheme.order is None:
                closed_forms.append(scheme)
                continue
            if isinstance(method, Sampler):
                reason = "is evaluated, not stepped: its error is that of the scheme it solves"
            elif isinstance(method, Stepper) and method.plain and not names:
                reason = "runs in the interpreter; the peer scipy is the same method and is measured instead"
        if reason:
            left_out.append((scheme.name, reason))
        else:
            schemes.append(scheme)
    return LineUp(tuple(schemes), tuple(closed_forms), tuple(left_out))
