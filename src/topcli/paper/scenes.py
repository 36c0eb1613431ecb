"""Experiments of the ledger: packaged scenes with changed keys, in doubles, with 50 digits or in rational numbers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np

from topcli.analysis.trajectory import Trajectory
from topcli.config.load import load_experiment
from topcli.config.models import Experiment
from topcli.contracts import Array, Invariant
from topcli.engine.loop import Run
from topcli.engine.precise.loop import PreciseRun
from topcli.errors import RunError
from topcli.paper.algebra import Draws
from topcli.runs.precise import precise_run
from topcli.runs.simulate import trajectory_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

DIGITS = 50
RATIONAL = ("precision=rational", "h=1/10")
"""Overrides of a run without rounding; its initial state must be rational."""
FIFTY = (f"precision={DIGITS}", "h=1/10")
"""Overrides of a run with 50 digits."""
VARIED = 3
"""Variants of a scene, with random parameters, on which a general statement is tried beside the scene itself."""
VARIED_STEPS = 3
AND_VARIED = f", and {VARIED} times with random parameters, state and h"


MOMENTS = ("A", "B", "C")
PARAMETERS = {
    "euler": MOMENTS,
    "euler+gamma": MOMENTS,
    "lagrange": ("A", "C", "mu"),
    "lagrange/inertial": (),
    "heavy": (*MOMENTS, "x0", "y0", "z0"),
    "kowalevski": ("c0",),
}
"""Parameters of each form of a top that the paper's equations leave open."""


@dataclass(frozen=True)
class Scene:
    """Packaged scene ``config`` with the overrides ``sets``, each ``key=value``."""

    config: str
    sets: tuple[str, ...] = ()

    def __str__(self) -> str:
        quoted = (f"'{text}'" if " " in text else text for text in self.sets)
        return " ".join([f"topcli run {self.config}", *(f"--set {text}" for text in quoted)])

    @property
    def code(self) -> str:
        """Command of the scene, marked as code."""
        return f"`{self}`"

    def with_sets(self, *sets: str) -> Scene:
        """The same scene with more overrides, which replace those of the same keys."""
        keys = {text.partition("=")[0] for text in sets}
        return Scene(self.config, (*(text for text in self.sets if text.partition("=")[0] not in keys), *sets))

    def experiment(self) -> Experiment:
        """Experiment of the scene."""
        return load_experiment(self.config, list(self.sets), any_precision=True)

    def varied(self, draws: Draws) -> Scene:
        """The same scene with random rational parameters of the top, initial state and h, and fewer steps."""
        top = self.experiment().top
        sets = [f"h={draws.step()}", f"N={min(self.experiment().N, VARIED_STEPS)}"]
        for name in PARAMETERS[top.form]:
            sets.append(f"top.{name}={draws.moment() if name in MOMENTS else draws.small()}")
        for name in top.vectors:
            vector = draws.unit() if name in top.unit_vectors else tuple(draws.small() for _ in range(3))
            sets.append(f"initial.{name}=[{', '.join(map(str, vector))}]")
        return self.with_sets(*sets)


@cache
def trajectory(scene: Scene) -> Trajectory:
    """Run of a scene in doubles; kept, because several claims look at it."""
    return trajectory_of(scene.experiment())


@dataclass(frozen=True)
class ExactMap:
    """Step of a scene's scheme in the arithmetic of the scene."""

    experiment: Experiment
    run: PreciseRun

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
        _, states, ending = Run(self.run.top, self.run.loop, np.array(y, dtype=np.object_), h, steps).collect()
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
        one = next(one for one in self.invariants(h) if one.name == name)
        in_doubles = (*self.experiment.top.invariants(), *self.experiment.modified)
        scale = next(float(one.scale(states.astype(float)).max()) for one in in_doubles if one.name == name)
        with self.run.arithmetic.active():
            values = one.value(states)
            return np.array([float(abs(value - values[0])) for value in values]) / scale

    def parameter(self, name: str) -> Fraction:
        """Parameter of the top."""
        return self.run.arithmetic.fraction(getattr(self.run.top, name))

    def number(self, value: Fraction) -> Any:
        """Number of this arithmetic."""
        with self.run.arithmetic.active():
            return self.run.arithmetic.number(value)


def exact_map(scene: Scene) -> ExactMap:
    """Step of a scene that has a precision other than double."""
    experiment = scene.experiment()
    run = precise_run(experiment)
    assert run is not None
    return ExactMap(experiment, run)


def exact_maps(scene: Scene) -> list[ExactMap]:
    """Steps of a scene and of its variants, all in the arithmetic of the scene."""
    draws = Draws(1)
    return [exact_map(one) for one in (scene, *(scene.varied(draws) for _ in range(VARIED)))]
