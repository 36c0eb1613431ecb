"""Models of a config: ``Config`` is the content of a file, ``Experiment`` the complete experiment."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Iterator, Mapping
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, InstanceOf

from topcli.analysis.crossings import CrossingSearch
from topcli.analysis.quantities import Quantity, quantities_of
from topcli.config.document import STRICT, as_integer, describe
from topcli.config.ranges import MAX_STEPS
from topcli.config.text import to_yaml
from topcli.config.written import WrittenNumbers
from topcli.contracts import Array, Invariant, Method, Scheme, Top
from topcli.engine.columns import ATTITUDES, column_names
from topcli.engine.numbers import DOUBLE, FEWEST_DIGITS, MAX_DIGITS, MOST_DIGITS, RATIONAL
from topcli.errors import quoted
from topcli.schemes.plugins import own_sources
from topcli.store.sources import digest_of_texts

MAX_NAME, MAX_NAME_BYTES = 100, 200
_NAME = re.compile(r"""(?![\s.-])[^<>:"/\\|?*]+(?<![\s.])""")
_DEVICES = (f"{port}{number}" for port in ("com", "lpt") for number in range(1, 10))
RESERVED = ("figures", "con", "prn", "aux", "nul", *_DEVICES)
"""Names that no run may have: that of the folder of pictures, and those of Windows's devices, with any ending."""


def name_fault(value: str) -> str:
    """Reason why ``value`` cannot name an experiment and its run folder on every system; empty if it can."""
    if value.partition(".")[0].strip().lower() in RESERVED:
        return f"{quoted(value)} is a reserved name of a folder; choose another one"
    short = len(value) <= MAX_NAME and len(value.encode()) <= MAX_NAME_BYTES
    if short and value.isprintable() and _NAME.fullmatch(value):
        return ""
    letters = f"at most {MAX_NAME} characters ({MAX_NAME_BYTES} bytes), none of them a control character or one of"
    ends = "no dot, dash or space at its beginning, no dot or space at its end"
    return f'{quoted(value)} cannot name a folder; give {letters} / \\ : * ? " < > |, {ends}'


def changed_name(base: str, digest: str) -> str:
    """Return the default name of a run with ``digest`` that differs from the config ``base``; long ones are cut."""
    while name_fault(name := f"{base.rstrip()}-{digest[:6]}") and len(base) > 1:
        base = base[:-1]
    return name


def _name(value: str) -> str:
    if fault := name_fault(value):
        raise ValueError(fault)
    return value


def _step(value: float) -> float:
    if value == 0.0:
        raise ValueError("must not be zero (negative is allowed)")
    return value


def _columns(value: tuple[str, ...]) -> tuple[str, ...]:
    if not value:
        raise ValueError("must name at least one column; leave the key out to record all")
    return value


def _precision(value: Any) -> Any:
    value = as_integer(value)
    if value in (DOUBLE, RATIONAL):
        return value
    if isinstance(value, int) and not isinstance(value, bool) and FEWEST_DIGITS <= value <= MOST_DIGITS:
        return value
    digits = f"a number of digits from {FEWEST_DIGITS} to {MOST_DIGITS}"
    raise ValueError(f"must be double, rational, or {digits}, not {describe(value)}")


Precision = Annotated[Any, AfterValidator(_precision)]
Name = Annotated[str, AfterValidator(_name)]
StepSize = Annotated[float, AfterValidator(_step)]
Count = Annotated[int, Field(ge=1, le=MAX_STEPS), BeforeValidator(as_integer)]
Columns = Annotated[tuple[str, ...], AfterValidator(_columns)]


class Output(BaseModel):
    """The recorded rows and columns, and the format of the series."""

    model_config = STRICT

    format: Literal["parquet", "csv"] = Field(default="parquet", description="the file format of the time series")
    every: Count = Field(default=1, description="the number of steps from one recorded row to the next (1 to N)")
    columns: Columns | None = Field(
        default=None,
        description="the columns to record, by name or symbol: step n, time t, components, invariants; by default all",
        json_schema_extra={"minItems": 1, "uniqueItems": True},
    )
    quantities: dict[str, Any] | None = Field(
        default=None,
        description="further quantities to record: for each a name and a formula of components, parameters, t and h",
        json_schema_extra={"additionalProperties": {"type": ["string", "number"]}},
    )
    attitude: Literal["quaternion", "euler-angles"] | None = Field(
        default=None,
        description="also record the attitude of the body: quaternion (q0 to q3) or euler-angles (psi, theta, phi)",
    )

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

    component: str | None = Field(
        default=None, description="the component of the state that is constant on the section", examples=["gamma2"]
    )
    quantity: Any = Field(
        default=None,
        description="instead of component: a formula that is constant on the section, written as in output.quantities",
        json_schema_extra={"type": ["string", "number", "null"]},
    )
    value: float = Field(default=0.0, description="the value of this component or quantity on the section")
    direction: Literal["up", "down", "both"] = Field(
        default="up", description="record crossings with increasing values (up), decreasing values (down), or both"
    )

    @property
    def formula(self) -> str:
        """The component or the formula of the quantity."""
        return self.component or str(self.quantity)

    def search(self, top: Top, method: Method, h: float, y0: Array) -> CrossingSearch:
        """Search for the crossings of the orbits of ``method`` from ``y0`` (m, d)."""
        quantity = quantities_of(type(top), {"section": self.formula})[0]

        def distance(n: NDArray[Any], states: Array) -> Array:
            return quantity.values(top, n, h, states) - self.value

        return CrossingSearch(top, method, h, y0, distance, self.direction)


SECTION_TALLY = 16
"""Steps from one state to the next at which a run that records crossings looks at the invariants."""


class Config(BaseModel):
    """A numerical experiment on a discrete spinning top."""

    model_config = STRICT

    name: Name | None = Field(
        default=None,
        description="the name of the experiment and of its run folder; by default the file name without its extension",
    )
    top: Any = Field(description="the top: its kind, or a section with its kind and parameters")
    initial: Any = Field(
        description="the initial state: the top's vectors, such as omega and gamma; or from: RUN, which takes the last "
        "state of a stored run",
    )
    ensemble: Any = Field(
        default=None,
        description="compute many trajectories; their initial states are listed, lie on a grid, or are drawn at random",
    )
    scheme: Any = Field(description="the scheme: its name, or a section with its name and options")
    h: StepSize = Field(description="the step size, a number other than zero, such as 0.001")
    N: Count | None = Field(
        default=None,
        description="the number of steps, a whole number from 1 to 1e12; T may be given instead",
    )
    T: StepSize | None = Field(
        default=None, description="the duration of the run, instead of N; T/h must be a whole number"
    )
    precision: Precision = Field(
        default=DOUBLE,
        description="the arithmetic: double, a number of decimal digits, or rational (exact fractions)",
    )
    max_digits: Annotated[int, Field(ge=1, le=10**7), BeforeValidator(as_integer)] | None = Field(
        default=None,
        description="if the precision is rational: the run stops when a number has more digits than this "
        f"({MAX_DIGITS} by default)",
    )
    section: PoincareSection | None = Field(
        default=None,
        description="record only the crossings of a Poincaré section; its keys define the section",
    )
    output: Output = Field(default=Output(), description="what to record, and in which format")


OUTSIDE_IDENTITY = ("name", "output.format")
"""Keys of a resolved config that do not change what a run computes."""


def identity_of(resolved: Mapping[str, Any]) -> dict[str, Any]:
    """Return what a run computes and records: a resolved config without its ``name`` and ``output.format``.

    It holds the top with its parameters, the initial state (or the section ``ensemble``), the scheme with all options,
    h, N, and the recorded rows and columns. Runs that differ in name or format only have the same bits.
    """
    kept = {key: value for key, value in resolved.items() if key != "name"}
    return kept | {"output": {key: value for key, value in resolved["output"].items() if key != "format"}}


def digest_of(resolved: Mapping[str, Any], own_code: str) -> str:
    """SHA-256 of ``identity_of`` a resolved config as canonical JSON, 64 hexadecimal digits.

    ``own_code`` is the digest of the code of a user's top and scheme, which a config only names.
    """
    return hashlib.sha256((canonical(identity_of(resolved)) + own_code).encode()).hexdigest()


canonical = json.JSONEncoder(sort_keys=True, separators=(",", ":"), allow_nan=False).encode
"""JSON with sorted keys and without spaces: equal plain data, equal text."""


UNIT_TOLERANCE, UNIT_LIMIT = 1e-12, 1e-2
"""Deviations of the square of a unit vector from 1: up to the first it counts as 1, up to the second with a warning.

The limit covers a vector that is rounded to two or three digits, and the last state of a scheme that does not conserve
the length: under HK, the squares in the packaged scenes deviate by up to 0.003.
"""


def unit_warnings(cls: type[Top], states: Array) -> Iterator[str]:
    """Yield a warning for each unit vector whose square is off 1 in some of the ``states`` (m, d)."""
    for name in cls.unit_vectors:
        excess = (states[:, slice(*cls.vectors[name])] ** 2).sum(axis=1) - 1.0
        worst = float(excess[np.argmax(np.abs(excess))])
        if abs(worst) > UNIT_TOLERANCE:
            fault = f"initial {name} is not a unit vector: {name}² is off by {worst:.3g}, which the run keeps"
            yield f"{fault}; initial.normalize: true makes it one"


class Experiment(BaseModel):
    """A numerical experiment, complete and validated.

    ``y0`` is the initial state in the order of ``top.components``; ``options`` are the validated options of
    ``scheme``; ``output.columns`` is None for all columns. With a ``precision`` other than double, ``written`` are the
    numbers of the config as they are written. ``topcli.config.load`` makes it.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    name: str
    top: InstanceOf[Top]
    y0: tuple[float, ...]
    scheme: InstanceOf[Scheme]
    options: InstanceOf[BaseModel]
    h: float
    N: int
    output: Output
    section: PoincareSection | None = None
    precision: int | str = DOUBLE
    max_digits: int = MAX_DIGITS
    written: InstanceOf[WrittenNumbers] | None = None

    @property
    def duration(self) -> float:
        """Time N*h at which the run ends; negative for a negative step."""
        return self.N * self.h

    @property
    def rows(self) -> int | None:
        """Number of rows of the series if the run completes; None for the crossings of a section."""
        return None if self.section else self.N // self.output.every + 1

    @property
    def tallied(self) -> int:
        """Number of steps from one state to the next in the report on invariants."""
        return SECTION_TALLY if self.section else self.output.every

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
        """Warnings about the initial state."""
        return list(unit_warnings(type(self.top), np.array([self.y0])))

    def method(self) -> Method:
        """Build the scheme for the top with the options."""
        return self.scheme.build(self.top, self.options)

    def of_all_steps(self) -> Experiment:
        """Return the same experiment without its section."""
        return self.model_copy(update={"section": None}) if self.section else self

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
            "initial": self.top.initial_section(self.y0),
            "scheme": {"name": self.scheme.name, **self.options.model_dump(mode="json")},
            "h": self.h,
            "N": self.N,
            **({"section": self.section.model_dump(mode="json", exclude_none=True)} if self.section else {}),
            "output": self.output.resolved(),
            **self._resolved_precision(),
        }

    def _resolved_precision(self) -> dict[str, Any]:
        """Entries of ``resolved`` that only runs in another precision than double have."""
        if self.written is None:
            return {}
        limit = {"max_digits": self.max_digits} if self.precision == RATIONAL else {}
        return {**self.written.resolved(self.top), "precision": self.precision, **limit}

    @property
    def own_code(self) -> str:
        """Digest of the source of the top and the scheme that are a user's own; empty if both are topcli's."""
        return digest_of_texts(own_sources(type(self.top), self.scheme).values())

    @property
    def digest(self) -> str:
        """SHA-256 of what the run computes and records, without name and format (``identity_of``)."""
        return digest_of(self.resolved(), self.own_code)

    def to_yaml(self) -> str:
        """Return the resolved config as YAML that loads to the same experiment."""
        return to_yaml(self.resolved())
