"""Experiments for the ledger of claims: packaged scenes with changed keys and different precisions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic_core import CoreSchema, core_schema

from topcli.analysis.trajectory import Trajectory
from topcli.config.load import load_experiment
from topcli.config.models import Experiment
from topcli.contracts import Array, Invariant
from topcli.engine.collect import orbit
from topcli.engine.machine import Machine
from topcli.engine.numbers import PreciseRun
from topcli.errors import RunError, nearest
from topcli.paper.algebra import Draws
from topcli.runs.plans import precise_of, trajectory_of

DIGITS = 50
OVERRIDES = {
    "rational": ("precision=rational", "h=1/10"),
    "fifty": (f"precision={DIGITS}", "h=1/10"),
    "generic": ("initial.omega=[0.7, -0.4, 1.3]", "initial.gamma=[0.6, 0.48, 0.64]"),
}
"""Overrides by name: a run without rounding, whose initial state must be rational; a run with 50 digits; a state in
general position, whose decimals are rational numbers."""
VARIED = 3
"""Variants of a scene, with random parameters, on which a general statement is tried beside the scene itself."""
VARIED_STEPS = 3
AND_VARIED = f", and {VARIED} repetitions with random parameters, states and h"

TIED = {"lagrange": "B", "kowalevski": "A"}
"""Parameter of a form of a top that its equations in the paper do not leave open."""


@dataclass(frozen=True)
class LedgerScene:
    """Packaged scene ``config`` with the overrides ``sets``, each ``key=value``."""

    config: str
    sets: tuple[str, ...] = ()

    @classmethod
    def read(cls, text: str) -> LedgerScene:
        """Scene of a name and overrides, each ``key=value`` or a name of ``OVERRIDES``, between blanks.

        >>> str(LedgerScene.read("euler_hk rational N=20"))
        'topcli run euler_hk --set precision=rational --set h=1/10 --set N=20'
        """
        config, *words = text.split()
        sets: list[str] = []
        for word in words:
            if "=" not in word and word not in OVERRIDES:
                raise ValueError(f"unknown override {word!r}; {nearest(word, OVERRIDES)}")
            sets += OVERRIDES.get(word, (word,))
        return cls(config, tuple(sets))

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: Any) -> CoreSchema:
        return core_schema.no_info_plain_validator_function(cls.read)

    def __str__(self) -> str:
        quoted = (f"'{text}'" if " " in text else text for text in self.sets)
        return " ".join([f"topcli run {self.config}", *(f"--set {text}" for text in quoted)])

    @property
    def code(self) -> str:
        """Command of the scene, marked as code."""
        return f"`{self}`"

    def with_sets(self, *sets: str) -> LedgerScene:
        """The same scene with more overrides, which replace those of the same keys."""
        keys = {text.partition("=")[0] for text in sets}
        return LedgerScene(self.config, (*(text for text in self.sets if text.partition("=")[0] not in keys), *sets))

    def experiment(self) -> Experiment:
        """Experiment of the scene."""
        return load_experiment(self.config, list(self.sets), any_precision=True)

    def trajectory(self) -> Trajectory:
        """Run of the scene in doubles; kept, because several claims look at it."""
        return _trajectory(self)

    def varied(self, draws: Draws) -> LedgerScene:
        """The same scene with random rational parameters of the top, initial state and h, and fewer steps."""
        top = self.experiment().top
        sets = [f"h={draws.step()}", f"N={min(self.experiment().N, VARIED_STEPS)}"]
        for name in type(top).model_fields:
            if name != TIED.get(top.form):
                sets.append(f"top.{name}={draws.moment() if name in 'ABC' else draws.small()}")
        for name in top.vectors:
            vector = draws.unit() if name in top.unit_vectors else tuple(draws.small() for _ in range(3))
            sets.append(f"initial.{name}=[{', '.join(map(str, vector))}]")
        return self.with_sets(*sets)


@cache
def _trajectory(scene: LedgerScene) -> Trajectory:
    return trajectory_of(scene.experiment())


@dataclass(frozen=True)
class ExactMap:
    """Step of a scene's scheme in the arithmetic of the scene."""

    experiment: Experiment
    run: PreciseRun
    machine: Machine

    @property
    def y0(self) -> NDArray[Any]:
        """Initial state (d,)."""
        return self.run.y0

    @property
    def eps(self) -> float:
        """Rounding error of a number; 0 for rational numbers."""
        return self.run.arithmetic.eps

    def orbit(self, y: Sequence[Any] | NDArray[Any], h: Any, steps: int) -> NDArray[Any]:
        """States (steps + 1, d) from ``y``. Raises RunError if a step fails."""
        _, states, ending = orbit(self.run.top, self.machine, np.array(y, dtype=np.object_), h, steps)
        if len(states) <= steps:
            raise RunError(f"{self.experiment.name}: {ending.message}")
        return states

    def step(self, y: Sequence[Any] | NDArray[Any], h: Any) -> NDArray[Any]:
        """State (d,) after one step of ``h`` from ``y``."""
        return self.orbit(y, h, 1)[1]

    def invariants(self, h: Any) -> tuple[Invariant, ...]:
        """Invariants of the top and modified integrals of the scheme, in this arithmetic."""
        scheme, top = self.experiment.scheme, self.run.top
        with self.run.arithmetic.active():
            modified = scheme.modified(top, h, self.experiment.options) if scheme.modified else ()
            return (*top.invariants(), *modified)

    def deviations(self, name: str, states: NDArray[Any], h: Any) -> Array:
        """Deviations (n,) of the invariant ``name`` from its first value, relative to the size of its terms."""
        in_doubles = (*self.experiment.top.invariants(), *self.experiment.modified)
        scale = float(invariant_named(in_doubles, name).scale(states.astype(float)).max())
        exact = invariant_named(self.invariants(h), name)
        with self.run.arithmetic.active():
            values = exact.value(states)
            return np.array([float(abs(value - values[0])) for value in values]) / scale

    def fractions(self, values: Any) -> Any:
        """Rational numbers of an array of numbers, or of one."""
        return np.frompyfunc(self.run.arithmetic.fraction, 1, 1)(values)

    def parameter(self, name: str) -> Fraction:
        """Parameter of the top."""
        return self.fractions(getattr(self.run.top, name))

    def number(self, value: Fraction) -> Any:
        """Number of this arithmetic."""
        with self.run.arithmetic.active():
            return self.run.arithmetic.number(value)

    def numbers(self, values: Sequence[Any] | NDArray[Any]) -> NDArray[Any]:
        """Array of numbers of this arithmetic."""
        return np.array([self.number(Fraction(value)) for value in values], dtype=np.object_)


def exact_map(scene: LedgerScene) -> ExactMap:
    """Step of a scene that has a precision other than double."""
    experiment = scene.experiment()
    run = precise_of(experiment)
    assert run is not None
    return ExactMap(experiment, run, Machine(run.top, experiment.method(), run.loop))


def exact_maps(scene: LedgerScene, varied: bool = True) -> list[ExactMap]:
    """Steps of a scene and, if ``varied``, of its variants, all in the arithmetic of the scene."""
    draws = Draws(1)
    return [exact_map(scene), *(exact_map(scene.varied(draws)) for _ in range(VARIED if varied else 0))]


def invariant_named(invariants: Sequence[Invariant], name: str) -> Invariant:
    """Invariant with this name."""
    return next(invariant for invariant in invariants if invariant.name == name)
