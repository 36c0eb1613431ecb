"""Models of a config: ``Config`` is the content of a file, ``Experiment`` the complete experiment."""

from __future__ import annotations

import math
import re
from typing import Annotated, Any, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, InstanceOf, model_validator

from topcli.analysis.crossings import CrossingSearch
from topcli.analysis.quantities import Quantity, quantities_of
from topcli.config.document import STRICT, as_integer, describe
from topcli.config.ensemble import Ensemble, EnsembleSection
from topcli.config.states import unit_warnings
from topcli.config.text import to_yaml
from topcli.config.written import WrittenNumbers
from topcli.contracts import Array, Invariant, Method, Scheme, Top
from topcli.engine.columns import ATTITUDES, column_names
from topcli.engine.numbers import DOUBLE, FEWEST_DIGITS, MAX_DIGITS, MOST_DIGITS, RATIONAL
from topcli.errors import UsageError, quoted
from topcli.plugins import own_sources
from topcli.store.identity import digest_of, digest_of_texts

MAX_NAME = 100
_NAME = re.compile(rf"(?!figures$)\w[\w+.() -]{{0,{MAX_NAME - 1}}}(?<![ .])")
"""Names of folders; that of pictures is no name of a run."""


def folder_name_fault(value: str) -> str:
    """Reason why ``value`` cannot name an experiment and its run folder; empty if it can."""
    if _NAME.fullmatch(value):
        return ""
    letters = f"use at most {MAX_NAME} letters, digits, spaces or _ - + . ( ), beginning with a letter or digit"
    return f"{quoted(value)} cannot name a folder; {letters}"


def changed_name(base: str, digest: str) -> str:
    """Return the default name of a run with ``digest`` that differs from the config ``base``; long ones are cut."""
    return f"{base[: MAX_NAME - 7].rstrip()}-{digest[:6]}"


def _name(value: str) -> str:
    if fault := folder_name_fault(value):
        raise ValueError(fault)
    return value


def _step(value: float) -> float:
    if value == 0.0:
        raise ValueError("must not be zero (negative is allowed)")
    return value


def _precision(value: Any) -> Any:
    if value in (DOUBLE, RATIONAL) or (type(value) is int and FEWEST_DIGITS <= value <= MOST_DIGITS):
        return value
    digits = f"a number of digits from {FEWEST_DIGITS} to {MOST_DIGITS}"
    raise ValueError(f"must be double, rational, or {digits}, not {describe(value)}")


MAX_STEPS = 10**12
WHOLE_NUMBER = 4.0 * 2.0**-52
"""Relative deviation of T/h from a whole number that is accepted, for the rounding of T, h and their quotient."""


def steps_of(T: float, h: float) -> int:
    """Return the number of steps T/h, a whole number within round-off (4 ulp).

    >>> steps_of(50, 0.001)
    50000

    Raises UsageError with the nearest T that fit.
    """
    ratio = T / h
    if 0.5 <= ratio <= MAX_STEPS + 0.5 and abs(ratio - (N := round(ratio))) <= WHOLE_NUMBER * N:
        return N
    if not 0.0 < ratio <= MAX_STEPS:
        raise UsageError(f"T/h = {T:g}/{h:g} = {ratio:.6g} steps; must be from 1 to {MAX_STEPS}")
    counts = [N for N in (math.floor(ratio), math.floor(ratio) + 1) if 1 <= N <= MAX_STEPS]
    near = " or ".join(f"T = {_duration(N, h)} (N = {N})" for N in counts)
    raise UsageError(f"T/h = {T:g}/{h:g} = {ratio:.9g} is not a whole number of steps; nearest: {near}")


def _duration(N: int, h: float) -> str:
    """Text of the T that gives N steps, with few digits if these do."""
    text = f"{N * h:.15g}"
    return text if abs(float(text) / h - N) <= WHOLE_NUMBER * N else repr(N * h)


Name = Annotated[str, AfterValidator(_name)]
StepSize = Annotated[float, AfterValidator(_step)]
Count = Annotated[int, Field(ge=1, le=MAX_STEPS), BeforeValidator(as_integer)]
Precision = Annotated[Any, BeforeValidator(as_integer), AfterValidator(_precision)]


class Output(BaseModel):
    """The recorded rows and columns, and the format of the series."""

    model_config = STRICT

    format: Literal["parquet", "csv"] = "parquet"
    """the file format of the time series"""
    every: Count = 1
    """the number of steps from one recorded row to the next (1 to N)"""
    columns: tuple[str, ...] | None = Field(default=None, min_length=1)
    """the columns: n, t, components, invariants; by default all"""
    quantities: dict[str, Any] | None = None
    """further columns: for each a name and a formula of components, parameters, t and h"""
    attitude: Literal["quaternion", "euler-angles"] | None = None
    """also record the attitude: quaternion (q0 to q3) or euler-angles (psi, theta, phi)"""

    def resolved(self) -> dict[str, Any]:
        """Return the section as plain data; ``quantities`` and ``attitude`` only if they are given."""
        optional = ("quantities", "attitude")
        return {key: value for key, value in self.model_dump(mode="json").items() if key not in optional or value}

    @property
    def attitude_columns(self) -> tuple[str, ...]:
        """Names of the columns of the attitude; empty without it."""
        return ATTITUDES[self.attitude] if self.attitude else ()


class PoincareSection(BaseModel):
    """The surface of a Poincaré section; a run records the crossings of this surface instead of its steps."""

    model_config = STRICT

    component: str | None = None
    """the component that is constant on the section"""
    quantity: Any = None
    """instead of component: a formula, as in output.quantities"""
    value: float = 0.0
    """the value of this component or quantity on the section"""
    direction: Literal["up", "down", "both"] = "up"
    """crossings with rising or falling values, or both"""

    @model_validator(mode="after")
    def check_one(self) -> Self:
        """Require a component or a quantity."""
        if (self.component is None) == (self.quantity is None):
            raise ValueError("needs either component or quantity; for example component: gamma3")
        return self

    @property
    def formula(self) -> str:
        """The component or the formula of the quantity."""
        return self.component or str(self.quantity)

    def search(self, top: Top, method: Method, h: float, y0: Array) -> CrossingSearch:
        """Search for the crossings of the orbits of ``method`` from ``y0`` (m, d)."""
        quantity = quantities_of(type(top), {"crossings": self.formula})[0]

        def distance(n: NDArray[Any], states: Array) -> Array:
            return quantity.values(top, n, h, states) - self.value

        return CrossingSearch(top, method, h, y0, distance, self.direction)


CROSSINGS_TALLY = 16
"""Steps from one state to the next at which a run that records crossings looks at the invariants."""


class Config(BaseModel):
    """A numerical experiment on a discrete spinning top."""

    model_config = STRICT

    name: Name | None = None
    """the name of the run folder; by default that of the file"""
    top: Any
    """the top: its kind, or a section with its kind and parameters"""
    initial: Any = {}
    """the initial state: the top's vectors, such as omega and gamma; or from: RUN, a stored run"""
    ensemble: EnsembleSection | None = None
    """many initial states: listed, on a grid, or drawn at random"""
    scheme: Any
    """the scheme: its name, or a section with its name and options"""
    h: StepSize
    """the step size, a number other than zero, such as 0.001"""
    N: Count | None = None
    """the number of steps, from 1 to 1e12; or T instead"""
    T: StepSize | None = None
    """the duration, instead of N; T/h must be a whole number"""
    precision: Precision = DOUBLE
    """double, a number of decimal digits, or rational"""
    max_digits: Count | None = None
    """if rational: end the run when a number has more digits (10000 by default)"""
    section: PoincareSection | None = None
    """record only the crossings of a Poincaré section"""
    output: Output = Output()
    """what to record, and in which format"""


class Experiment(BaseModel):
    """A numerical experiment, complete and validated: one trajectory, or an ``ensemble`` of which ``y0`` is the first.

    ``y0`` is the initial state in the order of ``top.components``; ``options`` are the validated options of
    ``scheme``; ``output.columns`` is None for all columns. With a ``precision`` other than double, ``written`` are the
    numbers of the config as they are written. ``topcli.config.load`` makes it.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    name: str
    top: InstanceOf[Top]
    y0: tuple[float, ...]
    ensemble: InstanceOf[Ensemble] | None = None
    scheme: InstanceOf[Scheme]
    options: InstanceOf[BaseModel]
    h: float
    N: int
    output: Output
    crossings: PoincareSection | None = None
    precision: int | str = DOUBLE
    max_digits: int = MAX_DIGITS
    written: InstanceOf[WrittenNumbers] | None = None

    @property
    def duration(self) -> float:
        """Time N*h at which the run ends; negative for a negative step."""
        return self.N * self.h

    @property
    def rows(self) -> int | None:
        """Number of rows of the series if no trajectory ends early; None for crossings of a Poincaré section."""
        each = self.N // self.output.every + 1
        if self.ensemble:
            return self.ensemble.count * {"trajectories": each, "final": 1, "statistics": 0}[self.ensemble.store]
        return None if self.crossings else each

    @property
    def tallied(self) -> int:
        """Number of steps from one state to the next in the report on invariants."""
        return CROSSINGS_TALLY if self.crossings else self.output.every

    @property
    def recorded(self) -> list[str]:
        """Names of the recorded columns; quantities and the attitude come last unless ``output.columns`` names them."""
        named = list(self.output.columns or column_names(self.top))
        further = (*(self.output.quantities or ()), *self.output.attitude_columns)
        return [*named, *(name for name in further if name not in named)]

    @property
    def quantities(self) -> tuple[Quantity, ...]:
        """Observables of the user."""
        return quantities_of(type(self.top), self.output.quantities)

    def state_warnings(self) -> list[str]:
        """Warnings about the initial states."""
        states = self.ensemble.states if self.ensemble else np.array([self.y0])
        return list(unit_warnings(type(self.top), states))

    def method(self) -> Method:
        """Build the scheme for the top with the options."""
        return self.scheme.build(self.top, self.options)

    def trajectory(self, index: int) -> Experiment:
        """Return trajectory ``index`` (from 0) of the ensemble by itself. Raises IndexError."""
        assert self.ensemble is not None
        if not 0 <= index < self.ensemble.count:
            raise IndexError(f"trajectory {index}: there are {self.ensemble.count}")
        group, row = divmod(index, len(self.ensemble.states))
        state = tuple(self.ensemble.states[row].tolist())
        name = f"{self.name}_{index}"
        return self.model_copy(update={"name": name, "top": self.ensemble.tops[group], "y0": state, "ensemble": None})

    def renamed(self, name: str) -> Experiment:
        """Return the same experiment under another name."""
        return self.model_copy(update={"name": name})

    @property
    def modified(self) -> tuple[Invariant, ...]:
        """Integrals of the scheme itself at this h."""
        return self.scheme.modified(self.top, self.h, self.options) if self.scheme.modified else ()

    def resolved(self) -> dict[str, Any]:
        """Return everything the run depends on as plain data that loads to the same experiment, bit for bit."""
        return {
            "name": self.name,
            "top": self.top.section(),
            "initial": self.ensemble.initial if self.ensemble else self.top.initial_section(self.y0),
            **({"ensemble": self.ensemble.section} if self.ensemble else {}),
            "scheme": {"name": self.scheme.name, **self.options.model_dump(mode="json")},
            "h": self.h,
            "N": self.N,
            **({"section": self.crossings.model_dump(mode="json", exclude_none=True)} if self.crossings else {}),
            "output": self.output.resolved(),
            **(self.written.resolved(self.top) | {"precision": self.precision} if self.written else {}),
            **({"max_digits": self.max_digits} if self.precision == RATIONAL else {}),
        }

    @property
    def own_code(self) -> str:
        """Digest of the source of the top and the scheme that are a user's own; empty if both are topcli's."""
        return digest_of_texts(own_sources(type(self.top), self.scheme).values())

    @property
    def digest(self) -> str:
        """SHA-256 of what the run computes and records, without name and format."""
        return digest_of(self.resolved(), self.own_code)

    def to_yaml(self) -> str:
        """Return the resolved config as YAML that loads to the same experiment."""
        return to_yaml(self.resolved())
