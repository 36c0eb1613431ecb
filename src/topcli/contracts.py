"""Types shared by all layers: Top, Scheme, Stepper, Sampler, Block, Invariant, Outcome.

All quantities are dimensionless, as in the paper: times, angular velocities and energies are pure numbers.

Rules for the author of a scheme:

1. ``step(state, h, p) -> state`` takes and returns flat tuples of floats, has no side effects, and uses only float
   arithmetic, functions of ``math``, and other functions of this kind. The engine can then compile it, and it also
   runs as plain Python. It raises nothing: a step that fails returns nan.
2. ``p`` is ``top.constants()``; ``h`` may be negative, and N = 1 is allowed.
3. Every declared trait (order, self-adjointness, exact invariants) is checked by the tests.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field, replace
from enum import StrEnum
from fractions import Fraction
from typing import Any, ClassVar, NamedTuple, Protocol, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict

from topcli.arithmetic.sized import Sized
from topcli.errors import UsageError

Floats = tuple[float, ...]
Array = NDArray[np.floating[Any]]
StepFunction = Callable[[Floats, float, Floats], Floats]


stop_asked: ContextVar[Callable[[], bool]] = ContextVar("stop_asked", default=lambda: False)
"""True as soon as the work at hand is to stop; set by ``stopping_when``."""


class StopAsked(Exception):  # noqa: N818 (no error)
    """Raised within work that is not worth finishing; a step counts as not taken."""


def check_stop() -> None:
    """Give up a plain step that takes long if the run is to stop; to be called every few milliseconds."""
    if stop_asked.get()():
        raise StopAsked


@contextmanager
def stopping_when(stop: Callable[[], bool]) -> Iterator[None]:
    """Let ``check_stop`` ask ``stop`` within the block, besides what it asks outside."""
    outer = stop_asked.get()
    token = stop_asked.set(lambda: stop() or outer())
    try:
        yield
    finally:
        stop_asked.reset(token)


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
        Maps states, shape (n, d), to the values of the invariant, shape (n,).
    scale : callable
        Maps states, shape (n, d), to the sum of the magnitudes of the terms that ``value`` adds, shape (n,).
        Round-off is measured relative to this scale, because a value near zero may be a difference of large terms.
    on : mapping of str to float, optional
        Values of invariants, this one perhaps among them, that the motion must have for this one to be conserved:
        ``{"m_gamma": 0.0}``. Empty if every motion conserves it.
    """

    name: str
    symbol: str
    tex: str
    meaning: str
    value: Callable[[Array], Array]
    scale: Callable[[Array], Array]
    on: Mapping[str, float] = field(default_factory=dict)


Integral = Callable[[Any, Floats], Any]
"""``integral(y, p)``: an invariant as a formula of the components of a state and the constants of the top."""


def invariant_of(
    name: str,
    integral: Integral,
    p: Floats,
    symbols: tuple[str, str] | None = None,
    on: Mapping[str, float] | None = None,
) -> Invariant:
    """Invariant of a formula, which is evaluated with the components as columns; its docstring is the meaning.

    ``symbols`` are those for terminals and in LaTeX, by default the name.
    """

    def value(y: Array) -> Array:
        return integral(tuple(y.T), p) + np.zeros(len(y), dtype=y.dtype)

    def scale(y: Array) -> Array:
        return Sized.of(integral(tuple(map(Sized, y.T)), p)).size + np.zeros(len(y))

    words = (integral.__doc__ or name).strip().splitlines()[0].rstrip(".")
    symbol, tex = symbols or (name, rf"\mathrm{{{name.replace('_', ' ')}}}")
    return Invariant(name, symbol, tex, words[:1].lower() + words[1:], value, scale, on or {})


@dataclass(frozen=True)
class EulerPoisson:
    """Coefficients of the general Euler-Poisson equations (Sogo, Discrete Spinning Tops, section 1.1).

    Parameters
    ----------
    moments : tuple of float
        Principal moments of inertia (A, B, C), positive.
    gravity : tuple of float
        Weight times centre of gravity, mg(x0, y0, z0).
    omega_sign : float, optional
        The first three components of the state are omega times this sign (+1 or -1); the others are gamma.
    """

    moments: tuple[float, float, float]
    gravity: tuple[float, float, float]
    omega_sign: float = 1.0

    def rates(self, y: Sequence[Any]) -> tuple[Any, ...]:
        """Rates of change of omega and gamma, the six numbers ``y``, in their arithmetic."""
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

    A subclass declares the parameters of the top as pydantic fields and sets ``kind``, ``components``, ``field``,
    ``integrals`` and, where the defaults do not do, the other class attributes below. It may implement ``constants``,
    ``invariants`` and, where the top is a case of the Euler-Poisson equations, ``euler_poisson``. See
    ``topcli.tops.heavy`` for a complete example.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    kind: ClassVar[str]
    """Name of the top in configs."""
    form: ClassVar[str]
    """Key that schemes are registered for: the kind, extended by the form of the state if there are several forms."""
    title: ClassVar[str]
    """Title for people, on one line; by default the first line of the docstring."""
    citation: ClassVar[str] = ""
    """Source of the equations of motion."""
    formula: ClassVar[str] = ""
    """Equations of motion in LaTeX: display formulas without delimiters, separated by empty lines."""
    components: ClassVar[tuple[str, ...]]
    """Names of the components of the state, in order."""
    vectors: ClassVar[Mapping[str, tuple[int, int]]]
    """Vectors of the initial state and their index ranges in the state, for example ``{"omega": (0, 3)}``; by default
    each component is given by itself."""
    unit_vectors: ClassVar[tuple[str, ...]] = ()
    """Names of those ``vectors`` that must have unit length."""
    energy: ClassVar[str] = "energy"
    """Name of the invariant that is the energy or a multiple of it (``analysis.columns``). A run far off its energy
    surface has the outcome ``left_motion``, and ensembles draw states of a given energy; neither works for a top
    without an invariant of this name."""
    energy_factor: ClassVar[float] = 1.0
    """Energy divided by the invariant ``energy``, for example 0.5 if that is twice the energy."""
    step_constants: ClassVar[tuple[str, ...]] = ()
    """Each number of ``constants``, the last argument ``p`` of a step, as the name of a parameter or a formula of
    parameters such as "c = c0/C"; for people. By default the names of the parameters."""
    in_space: ClassVar[bool] = False
    """True if the state is given in the frame fixed in space, as angular momentum and axis, not in the body's frame."""
    swing: ClassVar[str]
    """Component whose deep minima mark the swings of the top; by default the first one."""
    field: ClassVar[Callable[[Floats, Floats], Floats]]
    """Right-hand side ``field(state, constants)`` of the equations of motion, on flat tuples; must be compilable."""
    integrals: ClassVar[Mapping[str, Integral]] = {}
    """Integrals of the motion by name, each a function ``integral(state, constants)`` of flat tuples."""
    symbols: ClassVar[Mapping[str, tuple[str, str]]] = {}
    """Symbols of ``integrals`` for terminals and in LaTeX, for example ``{"energy": ("E", "E")}``."""
    holds_on: ClassVar[Mapping[str, Mapping[str, float]]] = {}
    """For ``integrals`` that only some motions conserve, ``Invariant.on``."""
    angular_velocity: ClassVar[Callable[[Floats, Floats], Floats] | None] = None
    """Angular velocity in the body's frame, ``angular_velocity(state, constants)``, three numbers, on flat tuples; for
    the attitude of a top that turns like a body. Must be compilable."""
    vertical: ClassVar[Callable[[Floats, Floats], Floats] | None] = None
    """Vector in the body's frame, as ``angular_velocity``, whose direction is fixed in space and is shown upright;
    None for a top without one."""

    @classmethod
    def __pydantic_init_subclass__(cls, **options: Any) -> None:
        """Set what a top does not declare."""
        own = vars(cls)
        for name in ("field", "angular_velocity", "vertical"):
            if inspect.isfunction(own.get(name)):
                setattr(cls, name, staticmethod(own[name]))
        if "kind" in own and "form" not in own:
            cls.form = cls.kind
        if not hasattr(cls, "title"):
            cls.title = (cls.__doc__ or getattr(cls, "kind", cls.__name__)).strip().splitlines()[0].rstrip(".")
        if "components" in own and "vectors" not in own:
            cls.vectors = {name: (i, i + 1) for i, name in enumerate(cls.components)}
        if "components" in own and not hasattr(cls, "swing"):
            cls.swing = cls.components[0]
        if not cls.step_constants and cls.constants is Top.constants:
            cls.step_constants = tuple(cls.model_fields)

    def constants(self) -> Floats:
        """Return the constants of the equations of motion.

        Returns
        -------
        tuple of float
            Last argument of ``field`` and of every step; dimensionless. By default the parameters, in their order.
        """
        return tuple(getattr(self, name) for name in type(self).model_fields)

    def invariants(self) -> tuple[Invariant, ...]:
        """Return the integrals of the continuous motion.

        Returns
        -------
        tuple of Invariant
            In the order of the report. By default those of ``integrals``.
        """
        return self._invariants(self.integrals)

    def integrals_of(self, scheme: str, h: float) -> Mapping[str, Integral]:
        """Return the integrals of a scheme's map for this top, its modified integrals.

        Parameters
        ----------
        scheme : str
            Name of the scheme.
        h : float
            Step size.

        Returns
        -------
        mapping of str to callable
            Functions ``integral(state, constants)`` by name, which the map conserves exactly; at h = 0 they are
            integrals of the motion. By default there are none. The same symbols and levels apply as to ``integrals``.
        """
        return {}

    def modified_invariants(self, scheme: str, h: float) -> tuple[Invariant, ...]:
        """Return ``integrals_of`` as invariants."""
        return self._invariants(self.integrals_of(scheme, h))

    def _invariants(self, integrals: Mapping[str, Integral]) -> tuple[Invariant, ...]:
        p = self.constants()
        return tuple(
            invariant_of(name, integral, p, self.symbols.get(name), self.holds_on.get(name))
            for name, integral in integrals.items()
        )

    def euler_poisson(self) -> EulerPoisson:
        """Return the coefficients of this top in the general Euler-Poisson equations; optional.

        Returns
        -------
        EulerPoisson
            Of a rigid body without a rotor: for schemes and Lax forms that need its moments. ``checked_equations``
            compares it with ``field`` before it is used.
        """
        raise NotImplementedError

    def warnings(self) -> tuple[str, ...]:
        """Return warnings about unusual parameters that do not prevent a run.

        Returns
        -------
        tuple of str
            One line each. By default there is at most one, for moments of inertia that violate the triangle inequality.
        """
        try:
            moments = checked_equations(self, "the check of the moments").moments
        except UsageError:
            return ()
        (small, _), (middle, _), (large, axis) = sorted(zip(moments, "ABC", strict=True))
        if large <= (small + middle) * (1.0 + 1e-12):  # decimals such as 0.3, 0.1, 0.2 are rounded
            return ()
        listed = ", ".join(f"{moment:g}" for moment in moments)
        return (
            f"the moments ({listed}) violate the triangle inequality: {axis} = {large:g} > {small:g} + {middle:g}; "
            "no rigid body has such moments, but the equations are integrated",
        )

    @classmethod
    def new(cls) -> Self:
        """Return the top with its default parameters."""
        return cls()

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


AGREEMENT = 1e-12
"""Relative difference between ``field`` and ``euler_poisson`` that rounding may explain, component by component."""
PROBES = 4
SIZES = ((1.0, 1.0), (0.0, 1.0), (1.0, 0.0), (1e-6, 1.0), (1e6, 1.0))
"""Sizes of omega and gamma at which they are compared, so that no term hides behind a larger one."""


MOVED = 1e-6
"""Relative change of a vertical that finite differences may leave."""


def checked_rotation(top: Top, needed_by: str) -> None:
    """Check that ``top`` gives its angular velocity, and that its ``vertical`` is fixed in space.

    The rate of change of the vertical in the body's frame is vertical x angular velocity; it is compared at several
    states. ``needed_by`` is that of ``checked_equations``.

    Raises
    ------
    UsageError
        If the top gives no angular velocity, or if its vertical moves.
    """
    velocity, vertical = type(top).angular_velocity, type(top).vertical
    if velocity is None:
        raise UsageError(
            f"top {top.kind!r}: {needed_by} needs its angular velocity, which it does not declare; if it turns like a "
            "body, define angular_velocity, three numbers in the body's frame"
        )
    p, d = top.constants(), len(top.components)
    raised: list[Exception] = []
    for probe in range(PROBES):
        y = np.cos(np.arange(1.0, d + 1.0) + d * probe)  # in general position
        try:
            omega = velocity(tuple(y.tolist()), p)
            rates = np.array(top.field(tuple(y.tolist()), p), dtype=float)
            s = 1e-3 / max(1.0, float(np.abs(rates).max()))
            if not s > 0.0:  # beyond the range of a double there is nothing to compare
                continue
            near = [tuple((y + k * s * rates).tolist()) for k in (0, -2, -1, 1, 2)]
            along = [vertical(state, p) for state in near] if vertical else []
        except (ArithmeticError, ValueError) as error:  # outside the domain of a root or a logarithm, perhaps
            raised.append(error)
            continue
        for name, value in (("angular_velocity", omega), ("vertical", along[0] if along else omega)):
            if not isinstance(value, tuple) or len(value) != 3:
                raise UsageError(f"top {top.kind!r}: {name} must return a tuple of three numbers, not {value!r}")
        with np.errstate(all="ignore"):
            v = np.array(along or [omega] * 5, dtype=float)
            rate, turn = (v[1] - v[4] + 8.0 * (v[3] - v[2])) / (12.0 * s), np.cross(v[0], omega)
            rounding = np.abs(v).max() * (MOVED * (1.0 + np.abs(omega).max()) + AGREEMENT / s)
            moves = vertical is not None and np.abs(rate - turn).max() > rounding + MOVED * np.abs(rate).max()
        if moves:
            shown = [", ".join(f"{value:.6g}" for value in vector) for vector in (rate, turn, y)]
            raise UsageError(
                f"top {top.kind!r}: its vertical is not fixed in space: it changes by ({shown[0]}), and "
                f"vertical x angular_velocity is ({shown[1]}), at ({shown[2]})"
            )
    if len(raised) == PROBES:
        error = f"{type(raised[-1]).__name__}: {raised[-1]}"
        raise UsageError(f"top {top.kind!r}: angular_velocity or vertical fails at every state that was tried: {error}")


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
        other = "use a scheme that needs the field alone, such as rk4, or " if needed_by.startswith("scheme") else ""
        raise UsageError(
            f"top {top.kind!r}: {needed_by} needs its Euler-Poisson equations, which it does not give; "
            f"{other}define euler_poisson()"
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
    p, signs = tuple(map(float, top.constants())), np.array([equations.omega_sign] * 3 + [1.0] * 3)
    (A, B, C), (x0, y0, z0) = (map(float, three) for three in (equations.moments, equations.gravity))
    in_doubles = EulerPoisson((A, B, C), (x0, y0, z0))
    if d not in (3, 6):
        return equations, f"its state has {d} components; expected omega (3), or omega and gamma (6)"
    for probe in range(PROBES):
        direction = np.cos(np.arange(1.0, 7.0) + 6.0 * probe)  # in general position
        for omega, gamma in SIZES:
            y = np.concatenate([omega * direction[:3], (gamma if d == 6 else 0.0) * direction[3:]])
            sized = [Sized.of(rate) for rate in in_doubles.rates(tuple(map(Sized, (signs * y).tolist())))]
            expected, terms = signs * [one.value for one in sized], np.array([one.size for one in sized])
            with np.errstate(all="ignore"):
                rates = np.array(field(tuple(y[:d].tolist()), p), dtype=float)
            if rates.shape != (d,):
                return equations, f"the field has {rates.size} components, the state {d}"
            # beyond the range of a double there is nothing to compare
            judged = np.isfinite(rates) & np.isfinite(terms[:d])
            with np.errstate(all="ignore"):
                wrong = judged & (np.abs(rates - expected[:d]) > AGREEMENT * terms[:d])
            if wrong.any():
                i = int(np.argmax(wrong))
                state = ", ".join(f"{value:.3g}" for value in y[:d])
                return equations, (
                    f"{top.components[i]}' is {rates[i]:.10g} by the field and {expected[i]:.10g} by the equations "
                    f"at ({state})"
                )
    return equations, ""


class NoOptions(BaseModel):
    """Options of a scheme that has none."""

    model_config = ConfigDict(frozen=True, extra="forbid")


def same_state(state: Any, h: float, p: Any) -> Any:
    """``enter`` or ``leave`` of a scheme that works on the physical state itself."""
    return state


@dataclass(frozen=True)
class Stepper:
    """Step of a scheme, built for one top; the engine compiles and iterates it.

    The step may work on another form of the state: scaled by h, in a stereographic coordinate, or extended by carried
    quantities such as a compensation term. ``enter`` converts the physical state to this working state and ``leave``
    converts it back; only the result of ``leave`` is recorded.

    Parameters
    ----------
    step : callable
        ``step(state, h, p) -> state`` on working states, flat tuples of ``width`` floats; ``p`` is ``top.constants()``.
    width : int
        Length of the working state.
    enter : callable, optional
        ``enter(y, h, p)``: working state from the physical state. None if they are the same.
    leave : callable, optional
        ``leave(state, h, p)``: physical state from the working state. None if they are the same.
    counters : tuple of str, optional
        Names of the trailing slots of the working state, which count events. They are reported and never affect the
        physical state.
    plain : bool, optional
        True if the step calls functions that cannot be compiled; it then runs in the interpreter. A step that may take
        seconds calls ``check_stop`` on the way.
    iterative : bool, optional
        True if the slot before the counters is a status: 0.0, or nan if the iteration did not converge. The run then
        ends as ``no_convergence``.
    checked : int, optional
        Number of leading slots tested for finiteness; a run ends as ``blew_up`` at the first value that is not finite.
        0 tests all slots. A slot need not be tested if its non-finite values reach the tested ones.
    advice : callable, optional
        ``advice(work, h)``: hint for the user of a run that ended as ``no_convergence``, from the working state that
        the failed step left.
    stages : tuple, optional
        For a composition: the base step and the fractions of h of its stages, in order. The composition stops after
        the first stage whose state is not finite. Ensembles then advance by one stage at a time.
    constants : tuple of Fraction, optional
        Constants of the step, exactly. They follow those of the top in its ``p``; ``enter`` and ``leave`` do not need
        them.
    source : callable, optional
        ``source()`` returns the source of code that is made from the top's field; None for a step that is written out.
        A step that is made is made again, from fractions, in other arithmetics.
    composable : Stepper, optional
        The same method on a working state that does not depend on h, for compositions and substeps. None if this
        working state does not depend on h either, or if there is no such form.
    tangent : callable, optional
        ``tangent()`` returns the Stepper of the state and a tangent vector, in this order the first 2 d slots of its
        working state. None if the tangent map is the step, differentiated by the compiler.
    """

    step: StepFunction
    width: int
    enter: StepFunction | None = None
    leave: StepFunction | None = None
    counters: tuple[str, ...] = ()
    plain: bool = False
    iterative: bool = False
    checked: int = 0
    advice: Callable[[Sequence[float], float], str] | None = None
    stages: tuple[StepFunction, tuple[float, ...]] | None = None
    constants: tuple[Fraction, ...] = ()
    source: Callable[[], str] | None = None
    composable: Stepper | None = None
    tangent: Callable[[], Stepper] | None = None

    def parameters(self, top: Top) -> Floats:
        """``p`` of the step for ``top``: its constants, then those of the step."""
        return (*top.constants(), *map(float, self.constants))


class Setup(Protocol):
    """Part of a closed form that depends on the initial state and the top alone; the engine keeps it on disk.

    ``y0`` is an initial state, shape (d,), ``p`` the constants of the top. A class of topcli whose objects need no
    arguments is also used in other processes.
    """

    seconds: float
    """Typical time to compute the set-up of one initial state."""

    def needed(self, y0: Array, p: Floats) -> bool:
        """True if the motion has a set-up, and this process does not have it yet."""
        ...

    def compute(self, y0: Array, p: Floats) -> bytes:
        """Compute the set-up, use it from then on, and return it. Raises RunError."""
        ...

    def use(self, y0: Array, p: Floats, data: bytes) -> None:
        """Use a set-up that ``compute`` has returned, in any process. Raises ValueError for other data."""
        ...

    def code(self) -> str:
        """Text that changes with everything on which the set-up depends besides ``y0`` and ``p``."""
        ...


class Accuracy(NamedTuple):
    """Limits of the accuracy of a closed form along one motion, in the units of the state."""

    round_off: float
    """Bound of the round-off in the states."""
    reason: str
    """Formula of the bound, with the components that it concerns."""
    sensitivity: float | None
    """Largest change of the states if each component of the initial state changes by one ulp; None if unknown."""


@dataclass(frozen=True)
class Sampler:
    """Closed-form solution, evaluated at the times of the steps instead of being iterated.

    Parameters
    ----------
    states : callable
        ``states(y0, h, n, p)`` takes the initial state, shape (d,), the step size, the step numbers, shape (m,), and
        the constants of the top; it returns the states after these numbers of steps, shape (m, d). A section asks for
        states between two steps too: ``n`` are then floats.
    setup : Setup, optional
        Work done once for each initial state, if it takes time. ``states`` does it by itself where nobody else has.
    accuracy : callable, optional
        ``accuracy(y0, h, n, p)`` returns the limits of the accuracy over the steps ``n`` (m,).
    attitude : callable, optional
        ``attitude(y0, q0, h, n, p)`` returns the quaternions of the attitude, shape (m, 4), which at the start is
        ``q0``, shape (4,). None if the attitude has no closed form; it is then summed up over the steps.
    """

    states: Callable[[Array, float, Any, Floats], Array]
    setup: Setup | None = None
    accuracy: Callable[[Array, float, NDArray[np.int64], Floats], Accuracy] | None = None
    attitude: Callable[[Array, Array, float, NDArray[np.int64], Floats], Array] | None = None


@dataclass(frozen=True)
class Block:
    """Method with its own time loop, which advances many steps per call.

    Parameters
    ----------
    text : callable
        ``text()`` returns a module in LLVM IR that defines ``advance(work, out, p, h, steps, every, until_record)``,
        the signature of the engine's time loop. The function advances at most ``steps`` steps of ``h``, writes the
        requested states to ``out``, and returns the number of steps taken, or minus the number of the failed step.
    enter : callable
        ``enter(y, work, p, h)`` fills ``work`` from the physical state ``y``, shape (d,).
    width : int
        Length of ``work``, which holds everything the loop needs to continue.
    counters : tuple of str, optional
        As in ``Stepper``.
    iterative : bool, optional
        As in ``Stepper``.
    advice : callable, optional
        As in ``Stepper``.
    tangent : callable, optional
        ``tangent()`` returns the Block of the state and a tangent vector, of 2 d components. None if there is none.
    """

    text: Callable[[], str]
    enter: Callable[[Any, Any, Any, float], int]
    width: int
    counters: tuple[str, ...] = ()
    iterative: bool = False
    advice: Callable[[Sequence[float], float], str] | None = None
    tangent: Callable[[], Block] | None = None


Method = Stepper | Sampler | Block


UNKNOWN = "none known to us"


@dataclass(frozen=True)
class Integrability:
    """Structure of a scheme that is an integrable map, beside its integrals.

    Parameters
    ----------
    lax : str
        Discrete Lax pair in a few words, or ``UNKNOWN``.
    poisson : str
        Poisson bracket that the map preserves, in a few words, or ``UNKNOWN``.
    bracket : str, optional
        ``"lie-poisson"`` if it is the bracket of the moment m and, if the state has one, of the vertical or the axis.
        The tests check it.
    """

    lax: str
    poisson: str
    bracket: str = ""


@dataclass(frozen=True)
class Scheme:
    """Time discretization of one form of a top, with its declared traits.

    Schemes are created by the decorator ``topcli.scheme``, whose documentation explains the parameters.
    """

    name: str
    """Name in configs, lower case."""
    top: str
    """Form of the top (``Top.form``)."""
    title: str
    """Title for people, on one line."""
    order: int | None
    """Order of convergence; None for an exact solution, or if the order follows from a tolerance."""
    explicit: bool
    """True if a step needs no iteration."""
    self_adjoint: bool
    """True if a step with -h inverts a step with h."""
    conserves: tuple[str, ...]
    """Names of the invariants conserved exactly, that is, to round-off."""
    citation: str
    """Source of the method."""
    equations: str
    """Equations of the source, or the formula of the step."""
    build: Callable[[Any, Any], Method]
    """``build(top, options)`` returns a Stepper, a Sampler (closed-form solution) or a Block."""
    modified: Callable[[Any, float, Any], tuple[Invariant, ...]] | None = None
    """``modified(top, h, options)`` returns the integrals of the scheme itself: they depend on h and are conserved
    exactly."""
    options: type[BaseModel] = NoOptions
    """Pydantic model of the options."""
    adaptive: bool = False
    """True if the method takes internal steps within each h, controlled by a tolerance. ``order`` is then the order of
    the formula, which is observed only if the tolerance is loose enough for one internal step per h."""
    limits: Mapping[str, str] = field(default_factory=dict, hash=False)
    """Conditions under which the scheme fails, each with the reason in a sentence. A key that names a hard case
    (``topcli stress``) is checked against the result of that case in both directions; any other key is a condition in
    words."""
    longest_step: Callable[[Any, Floats, Any], float] | None = None
    """``longest_step(top, y0, options)`` returns the largest ``abs(h)`` with which the scheme can start from the state
    ``y0``; a longer one is refused before the run. None if every h can be tried."""
    doc: str = ""
    """Description, from the docstring of ``build``."""
    origin: str = "topcli"
    """Distribution or file that registered the scheme."""
    order_with: Callable[[Any], int | None] | None = None
    """``order_with(options)``: order with these options, if it depends on them; ``order`` is that of the defaults."""
    formula: str = ""
    """Step in LaTeX: display formulas without delimiters, separated by empty lines. A prime marks the new state, a bar
    the mean of both, f is the right-hand side of the equations of motion."""
    integrable: Integrability | None = None
    """Structure of an integrable map; None for other schemes."""

    def order_for(self, options: Any) -> int | None:
        """Order of convergence with ``options``."""
        return self.order if self.order_with is None else self.order_with(options)


class Outcome(StrEnum):
    """Result of a run."""

    COMPLETED = "completed"
    LEFT_MOTION = "left_motion"
    BLEW_UP = "blew_up"
    NO_CONVERGENCE = "no_convergence"
    INTERRUPTED = "interrupted"
    DIGIT_LIMIT = "digit_limit"


@dataclass(frozen=True)
class Ending:
    """Outcome of a run, with the step at which it ended.

    Parameters
    ----------
    outcome : Outcome
        Result of the run.
    step : int
        Number of the last step taken, or of the failed step.
    t : float
        Time of ``step``, dimensionless.
    counters : mapping of str to int, optional
        Final values of the counters of the scheme.
    left : int, optional
        First recorded step at which the state was far off its energy surface, None for never. The run goes on; if
        nothing else ends it, its outcome is ``left_motion``.
    left_t : float, optional
        Time of ``left``, dimensionless.
    advice : str, optional
        Hint for the user of a run that did not converge.
    """

    outcome: Outcome
    step: int
    t: float
    counters: Mapping[str, int] = field(default_factory=dict)
    left: int | None = None
    left_t: float | None = None
    advice: str = ""

    def with_left(self, step: int | None, h: float) -> Ending:
        """The same ending of a run with steps of ``h`` that left its energy surface at ``step``; None for never."""
        if step is None:
            return self
        outcome = Outcome.LEFT_MOTION if self.outcome is Outcome.COMPLETED else self.outcome
        return replace(self, outcome=outcome, left=step, left_t=step * h)

    @property
    def message(self) -> str:
        """Description of the ending, one line."""
        where = f"at step {self.step} (t = {self.t:.6g})"
        completed = f"completed {self.step} step{'s' * (self.step != 1)} (t = {self.t:.6g})"
        left = "" if self.left is None else f"left its energy surface at step {self.left} (t = {self.left_t:.6g})"
        message = {
            Outcome.COMPLETED: completed,
            Outcome.LEFT_MOTION: f"{left}; {completed}",
            Outcome.BLEW_UP: f"blew up {where}: the state is no longer finite",
            Outcome.NO_CONVERGENCE: f"did not converge {where}" + (f"; {self.advice}" if self.advice else ""),
            Outcome.INTERRUPTED: f"interrupted {where}",
            Outcome.DIGIT_LIMIT: f"stopped {where}: the rational numbers have more digits than max_digits",
        }[self.outcome]
        return f"{message}; before, it {left}" if left and self.outcome is not Outcome.LEFT_MOTION else message
