"""The models of a config: ``Config`` is what a file holds, ``Experiment`` what it means."""

from __future__ import annotations

import hashlib
import json
import math
import unicodedata
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, InstanceOf

from topcli.contracts import Invariant, Method, Scheme, Top
from topcli.errors import quoted

MAX_STEPS = 10**12
MAX_NAME = 100
MAX_NAME_BYTES = 200


def name_fault(value: str) -> str:
    """Why ``value`` cannot be the name of an experiment and its run folder; empty when it can."""
    if not value.strip():
        return "must not be empty"
    if any(unicodedata.category(letter) in ("Cc", "Cf", "Cs", "Zl", "Zp") for letter in value):
        return f"must not hold control characters: {quoted(value)}"
    if len(value) > MAX_NAME or len(value.encode()) > MAX_NAME_BYTES:
        return f"must have at most {MAX_NAME} characters ({MAX_NAME_BYTES} bytes), not {len(value)}"
    if "/" in value or "\\" in value:
        return f"must not hold a path separator: {quoted(value)}"
    if odd := next((letter for letter in value if letter in '<>:"|?*'), None):
        return f"must not hold {odd!r}, which not every system allows in a file's name: {quoted(value)}"
    if value.lower() == "figures":
        return "must not be 'figures': the folder of that name holds the pictures"
    if value[0] in ".-":
        return f"must not start with a dot or a dash: {quoted(value)}"
    if value != value.strip():
        return f"must not start or end with a space: {quoted(value)}"
    return ""


def _name(value: str) -> str:
    if fault := name_fault(value):
        raise ValueError(fault)
    return value


def _step(value: float) -> float:
    if value == 0.0:
        raise ValueError("must not be zero (negative is allowed)")
    return value


def as_integer(value: Any) -> Any:
    """A whole number written as a float, such as 5e4, as an integer."""
    return int(value) if isinstance(value, float) and value.is_integer() else value


def _columns(value: tuple[str, ...]) -> tuple[str, ...]:
    if not value:
        raise ValueError("must name at least one column; leave the key out to record all")
    for index, name in enumerate(value):
        if name in value[:index]:
            raise ValueError(f"names {quoted(name)} twice")
    return value


Name = Annotated[str, AfterValidator(_name)]
StepSize = Annotated[float, AfterValidator(_step)]
Count = Annotated[int, Field(ge=1, le=MAX_STEPS), BeforeValidator(as_integer)]
Columns = Annotated[tuple[str, ...], AfterValidator(_columns)]


class Output(BaseModel):
    """What is recorded and how it is written."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)

    format: Literal["parquet", "csv"] = Field(default="parquet", description="the format of the series")
    every: Count = Field(default=1, description="record every so many steps (1 to N)")
    columns: Columns | None = Field(
        default=None,
        description="the columns to record, by name or symbol: n, t, components, invariants; all when absent",
        json_schema_extra={"minItems": 1, "uniqueItems": True},
    )


class Config(BaseModel):
    """A numerical experiment on a discrete spinning top."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)

    name: Name | None = Field(
        default=None,
        description="the name of the experiment and its run folder; the file's stem when absent",
        json_schema_extra={"maxLength": MAX_NAME, "pattern": r"^[^./\\\s-][^/\\]*$"},
    )
    top: Any = Field(description="the top: its kind, or a section with its kind and parameters")
    initial: Any = Field(description="the initial state: the top's vectors, such as omega and gamma")
    ensemble: Any = Field(
        default=None,
        description="many trajectories instead of one: their initial states as a list, a grid, or random draws",
    )
    scheme: Any = Field(description="the scheme: its name, or a section with its name and options")
    h: StepSize = Field(description="the step size, a number other than zero, such as 0.001")
    N: Count = Field(description="the number of steps, a whole number from 1 to 1e12")
    output: Output = Field(default=Output(), description="what is recorded and how it is written")


def digest_of(resolved: dict[str, Any]) -> str:
    """SHA-256 of a resolved config as canonical JSON, 64 hexadecimal digits."""
    text = json.dumps(resolved, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()


class Experiment(BaseModel):
    """A numerical experiment, complete and validated.

    ``y0`` is the initial state in the order of ``top.components``; ``options`` are the validated options of
    ``scheme``; ``output.columns`` is None for all columns. Made by ``topcli.config.load``.
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

    @property
    def scheme_name(self) -> str:
        """The scheme's name in lower case."""
        return self.scheme.name

    @property
    def duration(self) -> float:
        """The time N*h at which the run ends; negative for a negative step."""
        return self.N * self.h

    def method(self) -> Method:
        """The scheme made ready for the top, with the options."""
        return self.scheme.build(self.top, self.options)

    @property
    def modified(self) -> tuple[Invariant, ...]:
        """The integrals of the scheme itself at this h."""
        return self.scheme.modified(self.top, self.h, self.options) if self.scheme.modified else ()

    def resolved(self) -> dict[str, Any]:
        """Everything the run depends on as plain data, which loads to the same experiment, bit for bit."""
        vectors = {name: list(self.y0[start:stop]) for name, (start, stop) in self.top.vectors.items()}
        return {
            "name": self.name,
            "top": {"kind": self.top.kind, **self.top.model_dump(mode="json")},
            "initial": vectors,
            "scheme": {"name": self.scheme.name, **self.options.model_dump(mode="json")},
            "h": self.h,
            "N": self.N,
            "output": self.output.model_dump(mode="json"),
        }

    @property
    def digest(self) -> str:
        """sha256 of the resolved config as canonical JSON, 64 hexadecimal digits."""
        return digest_of(self.resolved())

    def to_yaml(self) -> str:
        """The resolved config as a YAML text that loads to the same experiment."""
        from topcli.config.emit import to_yaml

        return to_yaml(self.resolved())


def duration_fault(h: float, N: int) -> str:
    """Why N steps of h cannot be run; empty when they can."""
    return "" if math.isfinite(N * h) else f"N*h = {N} * {h!r} is not finite; take fewer or smaller steps"
