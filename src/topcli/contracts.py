"""Types shared by all layers: Top, Scheme, Stepper, Sampler, Block, Invariant, Outcome.

All quantities are dimensionless, as in the paper: times, angular velocities and energies are pure numbers.

Rules for the author of a scheme:

1. ``step(state, h, p) -> state`` takes and returns flat tuples of floats and has no side effects. It uses only float
   arithmetic, functions of ``math``, and other functions of this kind, so that the engine can compile it. It also runs
   as plain Python. It raises no exceptions: a step that fails returns nan.
2. ``p`` is ``top.constants()``; ``h`` may be negative, and N = 1 is allowed.
3. Every declared trait (order, self-adjointness, exact invariants) is checked by the tests.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from enum import StrEnum
from fractions import Fraction
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict

from topcli.arithmetic.fused import double_of
from topcli.arithmetic.sized import Sized
from topcli.errors import counted

Floats = tuple[float, ...]
Array = NDArray[np.floating[Any]]
StepFunction = Callable[[Floats, float, Floats], Floats]


_stop: ContextVar[Callable[[], bool]] = ContextVar("stop", default=lambda: False)


class StopAsked(Exception):  # noqa: N818 (no error)
    """Raised to abandon the current work; a step during which it is raised counts as not taken."""


def stop_asked() -> bool:
    """True as soon as the current work must stop; see ``stopping_when``."""
    return _stop.get()()


def check_stop() -> None:
    """Abandon a long plain step if the run must stop; a long step calls this function every few milliseconds."""
    if stop_asked():
        raise StopAsked


@contextmanager
def stopping_when(stop: Callable[[], bool]) -> Iterator[None]:
    """Within the block, stop the work once ``stop()`` is true; this is the only way to stop any work.

    A thread hears of it only if its work runs in a copy of this context (``contextvars.copy_context``).
    """
    outer = _stop.get()
    token = _stop.set(lambda: stop() or outer())
    try:
        yield
    finally:
        _stop.reset(token)


@dataclass(frozen=True)
class Invariant:
    """Function of the state that the exact flow conserves.

    Parameters
    ----------
    name : str
        Identifier used in columns and reports, for example ``"gamma_sq"``.
    symbol : str
        Symbol for terminal output, for example ``"γ²"``.
    tex : str
        Symbol in LaTeX, for figures.
    meaning : str
        Description in a few words, for example ``"length of the vertical, squared"``.
    value : callable
        ``value(states)`` returns the values of the invariant, shape (n,), for n states with d components, shape (n, d).
    scale : callable
        ``scale(states)`` returns the sum of the magnitudes of the terms that ``value`` adds, shape (n,). Round-off is
        measured relative to this scale, because a value near zero may be a difference of large terms.
    on : mapping of str to float, optional
        Conditions under which the invariant is conserved: names of other invariants, and their values. For example,
        with ``{"m_gamma": 0.0}``, only motions with m_gamma = 0 conserve it. Empty if every motion conserves it.
    """

    name: str
    symbol: str
    tex: str
    meaning: str
    value: Callable[[Array], Array]
    scale: Callable[[Array], Array]
    on: Mapping[str, float] = field(default_factory=dict)


PARTS = ("Source", "Equations", "Formula", "Limits")
"""Parts of the docstring of a scheme or a top, each under an underlined heading."""


def parts_of(doc: str) -> dict[str, str]:
    """Description in the docstring of a scheme or a top, and its ``PARTS``; empty if missing."""
    head, *rest = re.split(rf"^({'|'.join(PARTS)})\n-+\n", inspect.cleandoc(doc), flags=re.MULTILINE)
    texts = {"Description": head, **dict.fromkeys(PARTS, ""), **dict(zip(rest[::2], rest[1::2], strict=True))}
    return {name: text.strip() for name, text in texts.items()}


Integral = Callable[[Any, Floats], Any]
"""``integral(y, p)``: an invariant as a formula of the components of a state and the constants of the top."""


def of_numpy(x: Any) -> Any:
    """Double whose powers and quotients are infinite where those of Python raise; other numbers as they are."""
    return np.float64(x) if isinstance(x, float) else x


def invariant_of(
    name: str,
    integral: Integral,
    p: Floats,
    symbols: tuple[str, str] | None = None,
    on: Mapping[str, float] | None = None,
) -> Invariant:
    """Return the invariant with the formula ``integral``, which is evaluated with the components as columns.

    The docstring of the formula is the meaning of the invariant. ``symbols`` contains a symbol for terminals and one in
    LaTeX; by default, both are made from the name.
    """

    def value(y: Array) -> Array:
        with np.errstate(all="ignore"):  # what has no value is nan, and reports say so
            return integral(tuple(y.T), p) + np.zeros(len(y), dtype=y.dtype)

    def scale(y: Array) -> Array:
        with np.errstate(all="ignore"):
            return Sized.of(integral(tuple(map(Sized, y.T)), p)).size + np.zeros(len(y))

    words = (integral.__doc__ or name or "-").strip().splitlines()[0].rstrip(".")
    symbol, tex = symbols or (name, rf"\mathrm{{{name.replace('_', ' ')}}}")
    return Invariant(name, symbol, tex, words[:1].lower() + words[1:], value, scale, on or {})


@dataclass(frozen=True)
class EulerPoisson:
    """Coefficients of the Euler-Poisson equations of a heavy rigid body (Sogo, Discrete Spinning Tops, section 1.1).

    Parameters
    ----------
    moments : tuple of float
        Principal moments of inertia (A, B, C), positive.
    gravity : tuple of float
        Weight mg times the coordinates (x0, y0, z0) of the centre of gravity on the principal axes.
    omega_sign : float, optional
        Sign +1 or -1. The first three components of the state are the angular velocity omega times this sign; the
        others are the vertical gamma.
    """

    moments: tuple[float, float, float]
    gravity: tuple[float, float, float]
    omega_sign: float = 1.0

    def rates(self, y: Sequence[Any]) -> tuple[Any, ...]:
        """Return the rates of change of the six numbers ``y`` = (omega, gamma), in the arithmetic of these numbers."""
        (A, B, C), (x0, y0, z0), (w1, w2, w3, g1, g2, g3) = self.moments, self.gravity, y
        return (
            ((B * w2 * w3 - C * w3 * w2) + (g2 * z0 - g3 * y0)) / A,
            ((C * w3 * w1 - A * w1 * w3) + (g3 * x0 - g1 * z0)) / B,
            ((A * w1 * w2 - B * w2 * w1) + (g1 * y0 - g2 * x0)) / C,
            g2 * w3 - g3 * w2,
            g3 * w1 - g1 * w3,
            g1 * w2 - g2 * w1,
        )


class Top(BaseModel):
    """Base class of the tops.

    A subclass declares the parameters of the top as pydantic fields and sets ``kind``, ``components``, ``field`` and
    ``integrals``. The other class attributes have defaults. A subclass may also implement ``constants``, ``invariants``
    and, if the top is a heavy rigid body (Euler-Poisson equations), ``euler_poisson``. The module
    ``topcli.tops.kowalevski`` is a complete example.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    kind: ClassVar[str]
    """Name of the top in configs."""
    form: ClassVar[str]
    """Name under which schemes are registered for the top. It is the kind, extended if the state has several forms."""
    title: ClassVar[str]
    """Title on one line; by default the first line of the docstring, which may also contain the other texts."""
    citation: ClassVar[str] = ""
    """Source of the equations of motion; by default the part ``Source`` of the docstring."""
    formula: ClassVar[str] = ""
    """Equations of motion as display formulas in LaTeX, without delimiters, separated by empty lines; by default the
    part ``Formula`` of the docstring."""
    components: ClassVar[tuple[str, ...]]
    """Names of the components of the state, in order."""
    vectors: ClassVar[Mapping[str, tuple[int, int]]]
    """Vectors of the initial state and their index ranges in the state, for example ``{"omega": (0, 3)}``. By default,
    a config gives each component by itself."""
    unit_vectors: ClassVar[tuple[str, ...]] = ()
    """Names of the ``vectors`` that must have unit length."""
    energy: ClassVar[str] = "energy"
    """Name of the invariant that is the energy or a multiple of the energy. The outcome ``left_motion`` (far off the
    energy surface) and ensembles of a given energy need it. Both are unavailable for a top without an invariant of this
    name."""
    energy_factor: ClassVar[float] = 1.0
    """Energy divided by the invariant that ``energy`` names, for example 0.5 if the invariant is twice the energy."""
    step_constants: ClassVar[tuple[str, ...]] = ()
    """Description of each number in ``constants``, the last argument ``p`` of a step, for help texts. A description is
    the name of a parameter or a formula such as "c = c0/C". By default, these are the names of the parameters."""
    in_space: ClassVar[bool] = False
    """True if the state is given in the frame fixed in space, as angular momentum and axis, not in the body's."""
    swing: ClassVar[str]
    """Component whose deep minima mark the swings of the top; by default the first one."""
    field: ClassVar[Callable[[Floats, Floats], Floats]]
    """Right-hand side ``field(state, constants)`` of the equations of motion. It works on flat tuples and must be
    compilable."""
    integrals: ClassVar[Mapping[str, Integral]] = {}
    """Integrals of the motion by name. Each is a function ``integral(state, constants)`` of flat tuples."""
    hk: ClassVar[Mapping[str, Integral]] = {}
    """Integrals of the map of the scheme ``hk`` that a formula declares, some of them for special parameters. They are
    functions of the state and of the constants with h after them."""
    symbols: ClassVar[Mapping[str, tuple[str, str]]] = {}
    """Symbols of ``integrals`` for terminals and in LaTeX, for example ``{"energy": ("E", "E")}``."""
    holds_on: ClassVar[Mapping[str, Mapping[str, float]]] = {}
    """Levels of the ``integrals`` that only some motions conserve, by name; see ``on`` of ``Invariant``."""
    angular_velocity: ClassVar[Callable[[Floats, Floats], Floats] | None] = None
    """Function ``angular_velocity(state, constants)`` that returns the angular velocity in the body's frame as three
    numbers. A top that turns like a body needs it for its attitude. It must be compilable."""
    vertical: ClassVar[Callable[[Floats, Floats], Floats] | None] = None
    """Function ``vertical(state, constants)`` that returns a vector in the body's frame whose direction is fixed in
    space. Pictures show this direction upright. None for a top without one."""

    @classmethod
    def __pydantic_init_subclass__(cls, **options: Any) -> None:
        """Set what a top does not declare."""
        declared, parts = vars(cls), parts_of(cls.__doc__ or "")
        for name in ("field", "angular_velocity", "vertical"):
            if inspect.isfunction(declared.get(name)):
                setattr(cls, name, staticmethod(declared[name]))
        if "kind" in declared and "form" not in declared:
            cls.form = cls.kind
        texts = {"title": parts["Description"].partition("\n")[0].rstrip(".")}
        texts |= {"citation": " ".join(parts["Source"].split()), "formula": parts["Formula"]}
        for name, text in texts.items():
            if text and name not in declared:
                setattr(cls, name, text)
        if not hasattr(cls, "title"):
            cls.title = getattr(cls, "kind", cls.__name__)
        if "components" in declared and "vectors" not in declared:
            cls.vectors = {name: (i, i + 1) for i, name in enumerate(cls.components)}
        if "components" in declared and not hasattr(cls, "swing"):
            cls.swing = cls.components[0]
        if not cls.step_constants and cls.constants is Top.constants:
            cls.step_constants = tuple(cls.model_fields)

    def constants(self) -> Floats:
        """Return the constants of the equations of motion.

        Returns
        -------
        tuple of float
            Dimensionless constants, the last argument of ``field`` and of the step function of every scheme. By
            default, they are the values of the parameters of the top, in their order.
        """
        return tuple(getattr(self, name) for name in type(self).model_fields)

    def invariants(self) -> tuple[Invariant, ...]:
        """Return the integrals of the continuous motion.

        Returns
        -------
        tuple of Invariant
            Invariants in the order in which reports list them. By default, the invariants are made from ``integrals``.
        """
        return self._invariants(self.integrals)

    def integrals_of(self, scheme: str, h: float) -> Mapping[str, Integral]:
        """Return the modified integrals of a scheme for this top, that is, the integrals of its map.

        Parameters
        ----------
        scheme : str
            Name of the scheme.
        h : float
            Step size.

        Returns
        -------
        mapping of str to callable
            Functions ``integral(state, constants)`` by name, which the map conserves exactly. At h = 0 they are
            integrals of the motion. By default there are none. ``symbols`` and ``holds_on`` apply to them too.
        """
        return {}

    def modified_invariants(self, scheme: str, h: float) -> tuple[Invariant, ...]:
        """Return ``integrals_of`` as invariants."""
        return self._invariants(self.integrals_of(scheme, of_numpy(h)))

    def _invariants(self, integrals: Mapping[str, Integral]) -> tuple[Invariant, ...]:
        p = tuple(map(of_numpy, self.constants()))
        return tuple(
            invariant_of(name, integral, p, self.symbols.get(name), self.holds_on.get(name))
            for name, integral in integrals.items()
        )

    def euler_poisson(self) -> EulerPoisson:
        """Return the coefficients of this top in the general Euler-Poisson equations; a top need not define them.

        Returns
        -------
        EulerPoisson
            Coefficients for a rigid body without a rotor. Schemes and Lax pairs that need the moments of inertia use
            these coefficients, after ``tops.bodies`` has compared the equations with ``field``.
        """
        raise NotImplementedError

    @classmethod
    def new(cls) -> Self:
        """Return the top with its default parameters."""
        return cls()

    @classmethod
    def generic(cls) -> Self:
        """Return a top by which schemes decide what they conserve for all parameters."""
        return cls.new()

    def section(self, parameters: Mapping[str, Any] | None = None) -> dict[str, Any]:
        """Return the section ``top`` of a config as plain data, with these ``parameters`` in place of the top's own."""
        return {"kind": self.kind, **self.model_dump(mode="json"), **(parameters or {})}

    @classmethod
    def parameters_in(cls, section: object) -> dict[str, Any]:
        """Return the parameters that a section ``top`` of a config gives; none for a bare name."""
        return {key: value for key, value in section.items() if key != "kind"} if isinstance(section, dict) else {}

    @classmethod
    def initial_section(cls, state: Sequence[Any]) -> dict[str, Any]:
        """Return the section ``initial`` of a config: each vector as a list, one of a single component as a number."""
        return {
            name: list(state[start:stop]) if stop - start > 1 else state[start]
            for name, (start, stop) in cls.vectors.items()
        }


class NoOptions(BaseModel):
    """Options of a scheme that has none."""

    model_config = ConfigDict(frozen=True, extra="forbid")


def same_state(state: Any, h: float, p: Any) -> Any:
    """``enter`` or ``leave`` of a scheme that works on the physical state itself."""
    return state


@dataclass(frozen=True)
class Stepper:
    """Step of a scheme for one top; the engine compiles and iterates it.

    The step may work on another form of the state, the *working state*. For example, the working state may be scaled
    by h, use a stereographic coordinate, or have additional numbers such as the compensation terms of sums. ``enter``
    converts the physical state to the working state, and ``leave`` converts it back. Only the result of ``leave`` is
    recorded.

    Parameters
    ----------
    step : callable
        ``step(state, h, p)`` returns the working state after one step. A working state is a flat tuple of ``width``
        floats; ``p`` contains the constants of the top, ``top.constants()``.
    width : int
        Length of the working state.
    enter : callable, optional
        ``enter(y, h, p)`` returns the working state for the physical state ``y``. None if the working state is the
        physical state.
    leave : callable, optional
        ``leave(state, h, p)`` returns the physical state for a working state. None if the working state is the physical
        state.
    counters : tuple of str, optional
        Names of the last numbers of the working state if these numbers count events of the scheme. The counts are
        reported and never affect the physical state.
    plain : bool, optional
        True if the step calls functions that cannot be compiled. It then runs in the Python interpreter. A plain step
        that may take seconds must call ``check_stop`` every few milliseconds.
    iterative : bool, optional
        True if the last number of the working state before the counters is the status of an iteration. The status is
        0.0, or nan if the iteration did not converge; a run with status nan ends as ``no_convergence``.
    checked : int, optional
        How many numbers of the working state, from the first one on, are tested after each step. A run ends as
        ``blew_up`` if a tested number is not finite. With 0, all numbers are tested. A number needs no test if its
        non-finite values spread to tested numbers.
    stages : tuple, optional
        Only for a composition, which takes several steps (stages) of a base scheme in each of its own steps. ``stages``
        contains the step function of the base scheme, and the lengths of the stages as fractions of h, in order. The
        composition stops after the first stage whose state is not finite. Ensembles advance by one stage at a time.
    constants : tuple of Fraction, optional
        Constants of the step as exact fractions. In the argument ``p`` of the step, they follow the constants of the
        top. ``enter`` and ``leave`` do not need them.
    source : callable, optional
        ``source()`` returns the source code of a step that is generated from the top's field. None for a step written
        by hand. For a run in another precision than double, the code is generated again from exact constants.
    change : callable, optional
        ``change(state, h, p)`` returns the changes of the components, then the status and the numbers of counted
        events, if the step is the state plus this change. The sums can then be compensated.
    tangent : callable, optional
        ``tangent()`` returns a Stepper for a state together with a tangent vector. Its working state starts with the d
        components of the state, followed by the d components of the vector. None if the compiler can differentiate the
        step.
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
    constants: tuple[Fraction, ...] = ()
    source: Callable[[], str] | None = None
    change: StepFunction | None = None
    tangent: Callable[[], Stepper] | None = None

    def parameters(self, top: Top) -> Floats:
        """Return the argument ``p`` of the step: the constants of ``top``, then those of the step."""
        return (*top.constants(), *self.doubles)

    @property
    def doubles(self) -> Floats:
        """The ``constants`` as doubles; infinite beyond their range."""
        return tuple(double_of(c) for c in self.constants)


@dataclass(frozen=True)
class Sampler:
    """Scheme that evaluates a closed-form solution at the times of the steps, instead of iterating a step.

    Parameters
    ----------
    states : callable
        ``states(y0, h, n, p)`` takes the initial state, shape (d,), the step size, the step numbers, shape (m,), and
        the constants of the top. It returns the states after these numbers of steps, shape (m, d). For a Poincaré
        section, the numbers ``n`` may be fractions, because the section needs states between two steps.
    """

    states: Callable[[Array, float, Any, Floats], Array]


@dataclass(frozen=True)
class Block:
    """Scheme with its own time loop, which advances many steps per call.

    Parameters
    ----------
    text : callable
        ``text()`` returns a module in LLVM IR. It defines ``advance(work, out, p, h, steps, every, until_record)``,
        which replaces the engine's time loop. The function takes at most ``steps`` steps of length ``h``. It writes the
        state to ``out`` after ``until_record`` steps, and then each time that another ``every`` steps are done. It
        returns the number of steps taken or, if a step failed, minus the number of that step. The number may be less
        than ``steps``, even 0; the next call continues.
    enter : callable
        ``enter(y, work, p, h)`` fills ``work`` from the physical state ``y``, shape (d,).
    width : int
        Length of ``work``, which contains everything that the loop needs to continue.
    counters : tuple of str, optional
        As in ``Stepper``.
    iterative : bool, optional
        As in ``Stepper``.
    tangent : callable, optional
        ``tangent()`` returns a Block that advances a state together with a tangent vector, 2 d numbers in all. None if
        there is no such Block.
    """

    text: Callable[[], str]
    enter: Callable[[Any, Any, Any, float], int]
    width: int
    counters: tuple[str, ...] = ()
    iterative: bool = False
    tangent: Callable[[], Block] | None = None


Method = Stepper | Sampler | Block


@dataclass(frozen=True)
class Scheme:
    """Numerical scheme for one form of a top (one choice of state variables), with its declared properties.

    The decorator ``topcli.scheme`` creates schemes. Its parameters, which the page of ``topcli.scheme`` explains,
    become attributes of the scheme.
    """

    name: str
    """Name in configs, lower case."""
    top: str
    """Name under which schemes are registered for the top (``Top.form``), such as ``euler`` or
    ``lagrange/inertial``."""
    title: str
    """Title on one line."""
    order: int | None
    """Order of convergence; None for an exact solution, or if the scheme chooses its order from a tolerance."""
    explicit: bool
    """True if a step needs no iteration."""
    self_adjoint: bool
    """True if a step with -h inverts a step with h."""
    conserves: tuple[str, ...]
    """Names of the invariants that the scheme conserves exactly, that is, up to round-off."""
    citation: str
    """Source of the method."""
    equations: str
    """Equations of the source, or the formula of the step."""
    build: Callable[[Any, Any], Method]
    """``build(top, options)`` returns a Stepper, a Sampler (closed-form solution) or a Block."""
    modified: Callable[[Any, float, Any], tuple[Invariant, ...]] | None = None
    """``modified(top, h, options)`` returns the modified integrals of the scheme, which depend on h and are conserved
    exactly."""
    options: type[BaseModel] = NoOptions
    """Pydantic model of the options of the scheme."""
    adaptive: bool = False
    """True if the method divides each step into internal steps, whose lengths follow from a tolerance. ``order`` is
    then the order of an internal step. Runs show this order only if the tolerance is so loose that each step consists
    of one internal step."""
    limits: Mapping[str, str] = field(default_factory=dict, hash=False)
    """Conditions under which the scheme fails, each with the reason in a sentence. A key may be the name of a hard case
    of ``topcli stress``. The scheme must fail the hard cases that are keys, and it must not fail other hard cases. Any
    other key describes a condition in words."""
    longest_step: Callable[[Any, Floats, Any], float] | None = None
    """``longest_step(top, y0, options)`` returns the largest ``abs(h)`` with which the scheme can start from the state
    ``y0``. A run with a longer step is refused before it starts. None if the scheme has no longest step."""
    doc: str = ""
    """Description, from the docstring of ``build``."""
    origin: str = "topcli"
    """Installed Python package or file that registered the scheme."""
    order_with: Callable[[Any], int | None] | None = None
    """``order_with(options)`` returns the order, if it depends on the options; ``order`` is the order with the
    defaults."""
    formula: str = ""
    """Step as display formulas in LaTeX, without delimiters, separated by empty lines. A prime marks the new state, a
    bar marks the mean of the old and the new state, and f is the right-hand side of the equations of motion."""
    maker: Any = None
    """The decorated function."""

    def order_for(self, options: Any) -> int | None:
        """Order of convergence if the scheme has these ``options``."""
        return self.order if self.order_with is None else self.order_with(options)


class Outcome(StrEnum):
    """Way in which a run ended."""

    COMPLETED = "completed"
    """The run took all its steps."""
    LEFT_MOTION = "left_motion"
    """The run took all its steps, but its state moved far off the energy surface (the states with the initial
    energy)."""
    BLEW_UP = "blew_up"
    """A component of the state is no longer finite."""
    NO_CONVERGENCE = "no_convergence"
    """The iteration of an implicit step did not converge."""
    INTERRUPTED = "interrupted"
    """The run was stopped before its end."""
    DIGIT_LIMIT = "digit_limit"
    """In a run with exact fractions, the components of the state have more digits than ``max_digits`` in the config
    allows."""


@dataclass(frozen=True)
class Ending:
    """Outcome of a run, with the step at which it ended.

    Parameters
    ----------
    outcome : Outcome
        Way in which the run ended.
    step : int
        Number of the last step taken, or of the failed step.
    t : float
        Time t of that step, dimensionless.
    counters : mapping of str to int, optional
        Number of events of each kind that the scheme counted, by the name of the counter.
    left : int, optional
        First recorded step at which the energy differed much from its first value; None if there is no such step. The
        run goes on after this step. If it takes all its steps, its outcome is ``left_motion``.
    left_t : float, optional
        Time t of the step ``left``, dimensionless.
    """

    outcome: Outcome
    step: int
    t: float
    counters: Mapping[str, int] = field(default_factory=dict)
    left: int | None = None
    left_t: float | None = None

    @property
    def message(self) -> str:
        """Description of the ending, one line."""
        where = f"at step {self.step} (t = {self.t:.6g})"
        completed = f"completed {counted(self.step, 'step')} (t = {self.t:.6g})"
        left = "" if self.left is None else f"left its energy surface at step {self.left} (t = {self.left_t:.6g})"
        message = {
            Outcome.COMPLETED: completed,
            Outcome.LEFT_MOTION: f"{left}; {completed}",
            Outcome.BLEW_UP: f"blew up {where}: the state is no longer finite",
            Outcome.NO_CONVERGENCE: f"did not converge {where}",
            Outcome.INTERRUPTED: f"interrupted {where}",
            Outcome.DIGIT_LIMIT: f"stopped {where}: the rational numbers have more digits than max_digits",
        }[self.outcome]
        return f"{message}; before, it {left}" if left and self.outcome is not Outcome.LEFT_MOTION else message
