"""The contracts between the layers: Top, Scheme, Stepper, Invariant, Outcome.

Everything is dimensionless, as in the paper: times, angular velocities and energies are pure numbers.

An author of a scheme meets these duties:

1. ``step(state, h, p) -> state`` takes and returns flat tuples of floats, is pure, and uses only float
   arithmetic, ``math`` functions, and other such functions. It is then both compiled by the engine and
   runnable as plain Python.
2. ``p`` is ``top.constants()``; ``h`` may be negative, and N = 1 is a run like any other.
3. What the scheme declares (order, self-adjointness, exact invariants) is tested because it is declared.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextvars import ContextVar
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict

from topcli.errors import UsageError

Floats = tuple[float, ...]
Array = NDArray[np.floating[Any]]
StepFunction = Callable[[Floats, float, Floats], Floats]


stop_asked: ContextVar[Callable[[], bool]] = ContextVar("stop_asked", default=lambda: False)
"""Set by the engine while a plain step runs: True as soon as the run is to stop."""


class StopAsked(Exception):  # noqa: N818 (no error)
    """Raised within a step that is not worth finishing; the step counts as not taken."""


def heed_stop() -> None:
    """Give up a plain step that takes long if the run is to stop; to be called every few milliseconds."""
    if stop_asked.get()():
        raise StopAsked


@dataclass(frozen=True)
class Invariant:
    """A function of the state that the exact flow conserves.

    ``value`` maps states of shape (n, d) to (n,). ``scale`` maps them to the sum of the magnitudes of the
    terms that ``value`` adds up, shape (n,): the size that round-off is measured against, because a value
    near zero may be a difference of large terms.
    """

    name: str
    symbol: str
    tex: str
    meaning: str
    value: Callable[[Array], Array]
    scale: Callable[[Array], Array]


@dataclass(frozen=True)
class EulerPoisson:
    """Coefficients of the general Euler-Poisson equations: moments of inertia and mg(x0, y0, z0)."""

    moments: tuple[float, float, float]
    gravity: tuple[float, float, float]
    omega_sign: float = 1.0
    """The state's first three components are omega times this sign (+1 or -1), the others are gamma."""


class Top(BaseModel):
    """A top: its parameters (the fields of a subclass), its equations of motion and its integrals."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    kind: ClassVar[str]
    """What a config calls the top."""
    form: ClassVar[str]
    """What schemes are registered for: the kind, or the kind with the form of its state where it has several."""
    title: ClassVar[str]
    citation: ClassVar[str]
    components: ClassVar[tuple[str, ...]]
    """Names of the state's components in order."""
    vectors: ClassVar[Mapping[str, tuple[int, int]]]
    """Names of the vectors of the initial state and where they lie in it, e.g. ``{"omega": (0, 3)}``."""
    unit_vectors: ClassVar[tuple[str, ...]] = ()
    """Those of ``vectors`` that must have unit length."""
    energy: ClassVar[str] = "energy"
    """Name of the invariant that is the energy or a multiple of it. A run far off its energy surface has the outcome
    ``left_motion`` (``analysis.leaving``); a top without an invariant of this name never has it."""
    swing: ClassVar[str]
    """The component whose deep minima mark the swings of the top."""
    field: ClassVar[Callable[[Floats, Floats], Floats]]
    """The right-hand side ``field(state, constants)`` on flat tuples, compilable by the engine."""

    def constants(self) -> Floats:
        """The numbers that ``field`` and every step receive as their last argument."""
        raise NotImplementedError

    def invariants(self) -> tuple[Invariant, ...]:
        """The integrals of the continuous motion, in the order of the report."""
        raise NotImplementedError

    def euler_poisson(self) -> EulerPoisson:
        """The same top as a case of the general Euler-Poisson equations; need not be given.

        Never trusted as it is: ``checked_equations`` compares it with ``field``.
        """
        raise NotImplementedError

    def warnings(self) -> tuple[str, ...]:
        """What is unusual about the parameters though it can be computed, a line each.

        By default: moments of inertia that break the triangle inequality, which no rigid body has.
        """
        try:
            moments = checked_equations(self, "the check of the moments").moments
        except UsageError:
            return ()
        small, middle, large = sorted(moments)
        if large <= (small + middle) * (1.0 + 1e-12):  # decimals such as 0.3, 0.1, 0.2 are rounded
            return ()
        told = ", ".join(f"{moment:g}" for moment in moments)
        return (
            f"the moments ({told}) break the triangle inequality: {large:g} > {small:g} + {middle:g}; "
            "no rigid body has them",
        )

    @classmethod
    def new(cls) -> Self:
        """The top with its default parameters."""
        return cls()


AGREEMENT = 1e-12
"""Relative difference between ``field`` and ``euler_poisson`` that rounding may explain, component by component."""
PROBES = 4
SIZES = ((1.0, 1.0), (0.0, 1.0), (1.0, 0.0), (1e-6, 1.0), (1e6, 1.0))
"""Sizes of omega and gamma at which they are compared, so that no term hides behind a larger one."""


def checked_equations(top: Top, needed_by: str) -> EulerPoisson:
    """Return ``top.euler_poisson()`` after comparing it with ``top.field``.

    Parameters
    ----------
    top : Top
        Any top, also one from a user's file.
    needed_by : str
        What is about to use the equations, for the message: "scheme 'taylor'".

    Raises
    ------
    UsageError
        If the top gives no Euler-Poisson equations, or if they are not those of its field; the message names the
        component that differs.
    """
    try:
        equations, fault = _compared(top)
    except NotImplementedError:
        raise UsageError(
            f"top {top.kind!r}: {needed_by} needs its Euler-Poisson equations, which it does not give; "
            "use a scheme that needs the field alone, such as rk4, or define euler_poisson()"
        ) from None
    if fault:
        raise UsageError(f"top {top.kind!r}: euler_poisson(), which {needed_by} needs, is not its field: {fault}")
    return equations


def _compared(top: Top) -> tuple[EulerPoisson, str]:
    """The top's equations, and by how much which component of its field differs from them; empty if none does."""
    equations = top.euler_poisson()
    d, field = len(top.components), getattr(type(top), "field", None)
    if field is None:  # then the equations are all there is
        return equations, ""
    p = top.constants()
    if d not in (3, 6):
        return equations, f"its state has {d} components; expected omega (3), or omega and gamma (6)"
    for probe in range(PROBES):
        direction = np.cos(np.arange(1.0, 7.0) + 6.0 * probe)  # in general position
        for omega, gamma in SIZES:
            y = np.concatenate([omega * direction[:3], (gamma if d == 6 else 0.0) * direction[3:]])
            expected, terms = _euler_poisson_rates(equations, y)
            with np.errstate(all="ignore"):
                found = np.array(field(tuple(y[:d].tolist()), p), dtype=float)
            if found.shape != (d,):
                return equations, f"the field has {found.size} components, the state {d}"
            # beyond the range of a double there is nothing to compare
            judged = np.isfinite(found) & np.isfinite(terms[:d])
            with np.errstate(all="ignore"):
                wrong = judged & (np.abs(found - expected[:d]) > AGREEMENT * terms[:d])
            if wrong.any():
                i = int(np.argmax(wrong))
                state = ", ".join(f"{value:.3g}" for value in y[:d])
                return equations, (
                    f"{top.components[i]}' is {found[i]:.10g} by the field and {expected[i]:.10g} by the equations "
                    f"at ({state})"
                )
    return equations, ""


def _euler_poisson_rates(equations: EulerPoisson, y: Array) -> tuple[Array, Array]:
    """Right-hand side of the Euler-Poisson equations at a state (6,), and the magnitudes of its terms (6,)."""
    moments, gravity = np.array(equations.moments), np.array(equations.gravity)
    omega, gamma = equations.omega_sign * y[:3], y[3:]
    j, k = np.array([1, 2, 0]), np.array([2, 0, 1])
    with np.errstate(all="ignore"):
        turn = omega[j] * omega[k]
        torque = (moments[j] - moments[k]) * turn + (gamma[j] * gravity[k] - gamma[k] * gravity[j])
        size = (moments[j] + moments[k]) * np.abs(turn) + np.abs(gamma[j] * gravity[k]) + np.abs(gamma[k] * gravity[j])
        first, second = gamma[j] * omega[k], gamma[k] * omega[j]
        rates = np.concatenate([equations.omega_sign * torque / moments, first - second])
        return rates, np.concatenate([np.abs(size / moments), np.abs(first) + np.abs(second)])


class NoOptions(BaseModel):
    """Options of a scheme that has none."""

    model_config = ConfigDict(frozen=True, extra="forbid")


@dataclass(frozen=True)
class Stepper:
    """One scheme ready for one top: what the engine compiles and iterates.

    A scheme may work on another form of the state (scaled by h, a stereographic coordinate, with carried
    quantities such as a chart or a compensation term): ``enter`` makes that form from the physical state,
    ``leave`` gives the physical state back, and only what ``leave`` gives is recorded.
    ``width`` is the length of the working state. ``counters`` names its trailing slots that count events;
    they are reported, never fed back. A ``plain`` step calls what cannot be compiled; it runs in the interpreter, and
    one that may take seconds calls ``heed_stop`` on the way.
    The slot before the counters of an ``iterative`` step is its status: 0.0, or nan when the iteration did not
    converge. The run then ends there as ``no_convergence``.
    A run ends as ``blew_up`` where one of the first ``checked`` slots is not finite; 0 stands for all of them. Others
    need no looking at when they cannot but spoil these.
    A step made of ``stages`` names them: a step and the fractions of h that it is taken with in turn, in which the
    state counts as failed as soon as it is not finite. Ensembles then take one stage at a time.
    """

    step: StepFunction
    width: int
    enter: StepFunction | None = None
    leave: StepFunction | None = None
    counters: tuple[str, ...] = ()
    plain: bool = False
    iterative: bool = False
    checked: int = 0
    stages: tuple[StepFunction, tuple[float, ...]] | None = None


@dataclass(frozen=True)
class Sampler:
    """A solution in closed form: evaluated at the times of the steps, not iterated.

    ``states(y0, h, n, p)`` takes the initial state (d,), the step, step numbers (m,) and the constants of the top,
    and returns the states (m, d) after so many steps.
    """

    states: Callable[[Array, float, NDArray[np.int64], Floats], Array]


@dataclass(frozen=True)
class Block:
    """A method that advances many steps by itself: the engine compiles its time loop and calls that.

    ``text()`` is a module of LLVM's intermediate language with the function ``advance(work, out, p, h, steps, every,
    until_record)`` of the engine's time loop: it advances ``steps`` steps of ``h`` at most, records the states it is
    asked for, and returns the steps done, or minus the step that failed. ``enter(y, work, p, h)`` fills ``work`` of
    ``width`` slots, which hold all that the loop needs to go on. ``counters`` and ``iterative`` are a Stepper's.
    """

    text: Callable[[], str]
    enter: Callable[[Any, Any, Any, float], int]
    width: int
    counters: tuple[str, ...] = ()
    iterative: bool = False


Method = Stepper | Sampler | Block


@dataclass(frozen=True)
class Scheme:
    """A time discretization of one form of a top, with its declared traits."""

    name: str
    top: str
    title: str
    order: int | None
    """None for the exact solution, which has no error to have an order, and where the order follows a tolerance."""
    explicit: bool
    self_adjoint: bool
    conserves: tuple[str, ...]
    """Names of the invariants conserved exactly, that is to round-off."""
    citation: str
    equations: str
    build: Callable[[Any, Any], Method]
    """``build(top, options)``: a Stepper, a Sampler for a solution in closed form, or a Block."""
    modified: Callable[[Any, float, Any], tuple[Invariant, ...]] | None = None
    """``modified(top, h, options)``: integrals of the scheme itself, which depend on h; conserved exactly."""
    options: type[BaseModel] = NoOptions
    adaptive: bool = False
    """Takes as many steps of its own within each h as a tolerance asks for. ``order`` is then that of the formula: it
    is observed where the tolerance is so loose that one step is taken, and at a given tolerance h tells nothing."""
    limits: Mapping[str, str] = field(default_factory=dict, hash=False)
    """Where the scheme fails, and why: a sentence for each. A key that is the name of a hard case (``topcli stress``)
    is held against what happens there, both ways; any other key is a condition in words."""
    doc: str = ""
    origin: str = "topcli"
    """The distribution or file that registered the scheme."""


class Outcome(StrEnum):
    """How a run ended."""

    COMPLETED = "completed"
    LEFT_MOTION = "left_motion"
    BLEW_UP = "blew_up"
    NO_CONVERGENCE = "no_convergence"
    INTERRUPTED = "interrupted"


@dataclass(frozen=True)
class Ending:
    """How and where a run ended: ``step`` is the last step taken, or the step that failed.

    ``left`` is the first recorded step at which the state was far off its energy surface and ``left_t`` its time, None
    for never. The run goes on; where nothing else ends it, its outcome is ``left_motion``.
    """

    outcome: Outcome
    step: int
    t: float
    counters: Mapping[str, int] = field(default_factory=dict)
    left: int | None = None
    left_t: float | None = None

    def having_left(self, step: int | None, h: float) -> Ending:
        """The same ending of a run with steps of ``h`` that left its energy surface at ``step``; None for never."""
        if step is None:
            return self
        outcome = Outcome.LEFT_MOTION if self.outcome is Outcome.COMPLETED else self.outcome
        return replace(self, outcome=outcome, left=step, left_t=step * h)

    @property
    def message(self) -> str:
        """One line that says how the run ended."""
        where = f"at step {self.step} (t = {self.t:.6g})"
        completed = f"completed {self.step} step{'s' * (self.step != 1)} (t = {self.t:.6g})"
        left = "" if self.left is None else f"left its energy surface at step {self.left} (t = {self.left_t:.6g})"
        told = {
            Outcome.COMPLETED: completed,
            Outcome.LEFT_MOTION: f"{left}; {completed}",
            Outcome.BLEW_UP: f"blew up {where}: the state is no longer finite",
            Outcome.NO_CONVERGENCE: f"did not converge {where}",
            Outcome.INTERRUPTED: f"interrupted {where}",
        }[self.outcome]
        return f"{told}; before, it {left}" if left and self.outcome is not Outcome.LEFT_MOTION else told
