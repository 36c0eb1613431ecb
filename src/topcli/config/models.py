"""The models of a config: ``Config`` holds what a file says, ``Experiment`` the complete experiment.

The sections ``top``, ``initial`` and ``scheme`` and the columns, whose keys depend on the top and the scheme, are read
by the functions ``read_*``.
"""

from __future__ import annotations

import hashlib
import json
import math
import unicodedata
from collections.abc import Callable, Mapping, Sequence
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, InstanceOf

from topcli.analysis.attitude import ATTITUDES
from topcli.analysis.columns import column_names, spellings
from topcli.config.document import KeyPath, describe
from topcli.config.duration import MAX_STEPS
from topcli.config.exact import ExactNumbers
from topcli.config.problems import Problems, unknown_key, validate
from topcli.config.yaml_text import to_yaml
from topcli.contracts import Invariant, Method, Scheme, Top
from topcli.engine.fingerprint import own_code
from topcli.engine.precise.numbers import DOUBLE, FEWEST_DIGITS, MAX_DIGITS, MOST_DIGITS, RATIONAL
from topcli.errors import UnknownNameError, UsageError, nearest, quoted
from topcli.schemes.compose import COMPOSITIONS
from topcli.schemes.registry import composed, find_scheme, names_for
from topcli.tops import top_class, top_names

UNIT_TOLERANCE = 1e-12
"""Deviation of the square of a unit vector from 1 that is accepted."""
AUTO = {"auto": 1.0, "+auto": 1.0, "-auto": -1.0}
"""Texts for a component that completes a unit vector, with the component's sign."""
MOST_WRITTEN = 10_000
MAX_NAME = 100
MAX_NAME_BYTES = 200


def name_fault(value: str) -> str:
    """Reason why ``value`` cannot name an experiment and its run folder; empty if it can."""
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


def as_integer(value: Any) -> Any:
    """Return a whole number written as a float, such as 5e4, as an integer, and any other value as it is."""
    return int(value) if isinstance(value, float) and value.is_integer() else value


def _columns(value: tuple[str, ...]) -> tuple[str, ...]:
    if not value:
        raise ValueError("must name at least one column; leave the key out to record all")
    for index, name in enumerate(value):
        if name in value[:index]:
            raise ValueError(f"names {quoted(name)} twice")
    return value


def _precision(value: Any) -> Any:
    value = as_integer(value)
    if value in (DOUBLE, RATIONAL):
        return value
    if isinstance(value, int) and not isinstance(value, bool) and FEWEST_DIGITS <= value <= MOST_DIGITS:
        return value
    given = describe(value)
    raise ValueError(
        f"must be double, rational, or a number of digits from {FEWEST_DIGITS} to {MOST_DIGITS}, not {given}"
    )


Precision = Annotated[Any, AfterValidator(_precision)]
Name = Annotated[str, AfterValidator(_name)]
StepSize = Annotated[float, AfterValidator(_step)]
Count = Annotated[int, Field(ge=1, le=MAX_STEPS), BeforeValidator(as_integer)]
Columns = Annotated[tuple[str, ...], AfterValidator(_columns)]


class Output(BaseModel):
    """The recorded rows and columns, and the format of the series."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)

    format: Literal["parquet", "csv"] = Field(default="parquet", description="the format of the series")
    every: Count = Field(default=1, description="the number of steps from one recorded row to the next (1 to N)")
    columns: Columns | None = Field(
        default=None,
        description="the columns to record, by name or symbol: n, t, components, invariants; all when absent",
        json_schema_extra={"minItems": 1, "uniqueItems": True},
    )
    attitude: Literal["quaternion", "euler-angles"] | None = Field(
        default=None,
        description="also record the attitude of the body: quaternion (q0 to q3) or euler-angles (psi, theta, phi)",
    )
    digits: Annotated[int, Field(ge=1, le=MOST_WRITTEN), BeforeValidator(as_integer)] | None = Field(
        default=None,
        description="with a precision other than double: also write decimal texts of this many digits",
    )

    def resolved(self) -> dict[str, Any]:
        """Return the section as plain data; ``attitude`` and ``digits`` only if they are given."""
        optional = ("attitude", "digits")
        return {key: value for key, value in self.model_dump(mode="json").items() if key not in optional or value}

    @property
    def attitude_columns(self) -> tuple[str, ...]:
        """Names of the columns of the attitude; empty without it."""
        return ATTITUDES[self.attitude] if self.attitude else ()


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
    N: Count = Field(description="the number of steps, a whole number from 1 to 1e12; or T in its place")
    T: StepSize | None = Field(default=None, description="the time N*h to run, in the place of N: N = T/h is whole")
    precision: Precision = Field(
        default=DOUBLE,
        description="the arithmetic: double, a number of decimal digits, or rational (exact)",
        json_schema_extra={
            "anyOf": [
                {"enum": [DOUBLE, RATIONAL]},
                {"type": "integer", "minimum": FEWEST_DIGITS, "maximum": MOST_DIGITS},
            ]
        },
    )
    max_digits: Annotated[int, Field(ge=1, le=10**7), BeforeValidator(as_integer)] | None = Field(
        default=None,
        description=f"with precision rational: the length of the numbers at which the run stops ({MAX_DIGITS} digits "
        "when absent)",
    )
    output: Output = Field(default=Output(), description="what is recorded and how it is written")


OUTSIDE_IDENTITY = ("name", "output.format")
"""Keys of a resolved config that do not change what a run computes."""


def identity_of(resolved: Mapping[str, Any]) -> dict[str, Any]:
    """Return what a run computes and records: a resolved config without its ``name`` and ``output.format``.

    It holds the top with its parameters, the initial state (or the section ``ensemble``), the scheme with all options,
    h, N, and the recorded rows and columns. Runs that differ in name or format only have the same bits.
    """
    kept = {key: value for key, value in resolved.items() if key != "name"}
    return kept | {"output": {key: value for key, value in resolved["output"].items() if key != "format"}}


def digest_of(resolved: Mapping[str, Any], own_code: str = "") -> str:
    """SHA-256 of ``identity_of`` a resolved config as canonical JSON, 64 hexadecimal digits.

    ``own_code`` is the digest of the code of a user's top and scheme, which a config only names.
    """
    return hashlib.sha256((canonical(identity_of(resolved)) + own_code).encode()).hexdigest()


def canonical(data: object) -> str:
    """JSON with sorted keys and without spaces: equal plain data, equal text."""
    return json.dumps(data, sort_keys=True, separators=(",", ":"), allow_nan=False)


class Experiment(BaseModel):
    """A numerical experiment, complete and validated.

    ``y0`` is the initial state in the order of ``top.components``; ``options`` are the validated options of
    ``scheme``; ``output.columns`` is None for all columns. With a ``precision`` other than double, ``exact`` are the
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
    precision: int | str = DOUBLE
    max_digits: int = MAX_DIGITS
    exact: InstanceOf[ExactNumbers] | None = None

    @property
    def duration(self) -> float:
        """Time N*h at which the run ends; negative for a negative step."""
        return self.N * self.h

    @property
    def rows(self) -> int:
        """Number of rows of the series if the run completes."""
        return self.N // self.output.every + 1

    @property
    def recorded(self) -> list[str]:
        """Names of the recorded columns; those of the attitude come last unless ``output.columns`` names them."""
        named = list(self.output.columns or column_names(self.top))
        return [*named, *(name for name in self.output.attitude_columns if name not in named)]

    def method(self) -> Method:
        """Build the scheme for the top with the options."""
        return self.scheme.build(self.top, self.options)

    def renamed(self, name: str) -> Experiment:
        """Return the same experiment under another name."""
        return self.model_copy(update={"name": name})

    @property
    def modified(self) -> tuple[Invariant, ...]:
        """Integrals of the scheme itself at this h."""
        return self.scheme.modified(self.top, self.h, self.options) if self.scheme.modified else ()

    def resolved(self) -> dict[str, Any]:
        """Return everything the run depends on as plain data that loads to the same experiment, bit for bit."""
        vectors = {name: list(self.y0[start:stop]) for name, (start, stop) in self.top.vectors.items()}
        return {
            "name": self.name,
            "top": {"kind": self.top.kind, **self.top.model_dump(mode="json")},
            "initial": vectors,
            "scheme": {"name": self.scheme.name, **self.options.model_dump(mode="json")},
            "h": self.h,
            "N": self.N,
            "output": self.output.resolved(),
            **self._resolved_precision(),
        }

    def _resolved_precision(self) -> dict[str, Any]:
        """Entries of ``resolved`` that only runs in another precision than double have."""
        if self.exact is None:
            return {}
        limit = {"max_digits": self.max_digits} if self.precision == RATIONAL else {}
        return {**self.exact.resolved(self.top), "precision": self.precision, **limit}

    @property
    def own_code(self) -> str:
        """Digest of the code of the top and the scheme that are a user's own; empty if both are topcli's."""
        return own_code(type(self.top), self.scheme)

    @property
    def digest(self) -> str:
        """SHA-256 of what the run computes and records, without name and format (``identity_of``)."""
        return digest_of(self.resolved(), self.own_code)

    def to_yaml(self) -> str:
        """Return the resolved config as YAML that loads to the same experiment."""
        return to_yaml(self.resolved())


def duration_fault(h: float, N: int) -> str:
    """Reason why N steps of h cannot be run; empty if they can."""
    return "" if math.isfinite(N * h) else f"N*h = {N} * {h!r} is not finite; take fewer or smaller steps"


def read_top(raw: object, initial: object, problems: Problems) -> tuple[type[Top] | None, Top | None]:
    """Return the class of the top, and the top with its parameters; None for each that cannot be read.

    The vectors named in ``initial`` choose among the forms of a top.
    """
    section = _named_section(raw, "top", "kind", top_names, problems)
    if section is None:
        return None, None
    kind, where, parameters = section
    try:
        cls = top_class(kind, [key for key in initial if key != "normalize"] if isinstance(initial, dict) else ())
    except UnknownNameError as error:
        problems.add(where, str(error), unknown_name=True)
        return None, None
    return cls, validate(cls, parameters, ("top",), problems, beside=("kind",))


def read_scheme(raw: object, cls: type[Top], problems: Problems) -> tuple[Scheme, BaseModel] | None:
    """Return the scheme for tops of class ``cls``, composed if ``compose`` is given, and its options."""
    section = _named_section(raw, "scheme", "name", lambda: names_for(cls.form), problems)
    if section is None:
        return None
    name, where, given = section
    composition = given.get("compose", "")
    if "compose" in given and not isinstance(composition, str):
        problems.add(("scheme", "compose"), f"must be a name ({', '.join(COMPOSITIONS)}), not {describe(composition)}")
        return None
    try:
        scheme = find_scheme(name, cls.form)
        if "compose" in given:
            where = ("scheme", "compose")
            scheme = composed(scheme, composition)
    except UsageError as error:
        problems.add(where, str(error), unknown_name=isinstance(error, UnknownNameError))
        return None
    options = validate(scheme.options, given, ("scheme",), problems, beside=("name", "compose"))
    return None if options is None else (scheme, options)


def _named_section(
    raw: object, section: str, key: str, names: Callable[[], list[str]], problems: Problems
) -> tuple[str, KeyPath, dict[str, Any]] | None:
    """Return the name, its path and the whole section, from a bare name or a section with ``key``.

    ``names`` lists the known names and is called only for a message.
    """
    if isinstance(raw, str):
        return raw, (section,), {key: raw}
    if isinstance(raw, dict) and isinstance(raw.get(key), str):
        return raw[key], (section, key), raw
    known = ", ".join(names())
    if not isinstance(raw, dict):
        problems.add((section,), f"must be a name ({known}) or a section with {key!r}, not {describe(raw)}")
    elif key not in raw:
        near = [other for other in raw if other.lower() == key]
        missing = f"{key!r} is missing; known: {known}"
        problems.add((section,), f"{near[0]!r} should be {key!r}" if near else missing)
    else:
        problems.add((section, key), f"must be a name ({known}), not {describe(raw[key])}")
    return None


def read_initial(raw: object, cls: type[Top], problems: Problems) -> tuple[float, ...] | None:
    """Return the initial state in the order of the top's components, its unit vectors completed and checked."""
    names = list(cls.vectors)
    if not isinstance(raw, dict):
        problems.add(("initial",), f"must be a section with {', '.join(names)}, not {describe(raw)}")
        return None
    for key in raw:
        if key not in (*names, "normalize"):
            problems.add(("initial", key), unknown_key(key, [*names, "normalize"]))
    normalize = raw.get("normalize", False)
    if not isinstance(normalize, bool):
        problems.add(("initial", "normalize"), f"must be true or false, not {describe(normalize)}")
        return None
    state = [0.0] * len(cls.components)
    complete = True
    for name, (start, stop) in cls.vectors.items():
        if name not in raw:
            problems.add(("initial", name), f"missing; give a list of {stop - start} numbers")
            vector = None
        else:
            vector = read_vector(raw[name], cls, name, normalize, problems)
        if vector is None:
            complete = False
        else:
            state[start:stop] = vector
    return tuple(state) if complete else None


def read_vector(raw: object, cls: type[Top], name: str, normalize: bool, problems: Problems) -> list[float] | None:
    """Return the vector ``name`` of the initial state, completed; None if it is wrong."""
    start, stop = cls.vectors[name]
    components = cls.components[start:stop]
    path: KeyPath = ("initial", name)
    unit = name in cls.unit_vectors
    if not isinstance(raw, list) or len(raw) != len(components):
        given = f"{len(raw)}" if isinstance(raw, list) else describe(raw)
        wanted = f"{len(components)} numbers ({', '.join(components)})"
        problems.add(path, f"must be a list of {wanted}, not {given}")
        return None
    vector: list[float] = []
    autos: list[int] = []
    for index, (value, component) in enumerate(zip(raw, components, strict=True)):
        number = number_of(value)
        if unit and isinstance(value, str) and value in AUTO:
            autos.append(index)
            vector.append(AUTO[value])
        elif number is None:
            ending = ", or auto, +auto, -auto" if unit else ""
            problems.add(path, f"{component} must be a number{ending}, not {describe(value)}")
        elif not math.isfinite(number):
            problems.add(path, f"{component} must be a finite number, not {describe(value)}")
        else:
            vector.append(number)
    if len(vector) < len(components):
        return None
    if len(autos) > 1:
        problems.add(path, f"only one component may be auto, not {len(autos)}")
        return None
    if autos:
        return _completed(vector, autos[0], path, problems)
    return _unit(vector, normalize, path, problems) if unit else vector


def number_of(value: object) -> float | None:
    """Return ``value`` as a float, infinite if too large for one; None if it is not a number."""
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return None
    try:
        return float(value)
    except OverflowError:
        return math.inf


def _completed(vector: list[float], auto: int, path: KeyPath, problems: Problems) -> list[float] | None:
    """Return ``vector`` with component ``auto``, which holds the sign, set so that the length is one."""
    rest = sum(value * value for index, value in enumerate(vector) if index != auto)
    if rest > 1.0 + UNIT_TOLERANCE:
        others = f"the squares of the others sum to {rest:.15g} > 1"
        problems.add(path, f"auto cannot make it a unit vector: {others}; make them smaller")
        return None
    size = math.sqrt(max(1.0 - rest, 0.0))
    vector[auto] = math.copysign(size, vector[auto]) if size else 0.0
    return vector


def _unit(vector: list[float], normalize: bool, path: KeyPath, problems: Problems) -> list[float] | None:
    """Return ``vector``, scaled to unit length if ``normalize``; None if its length is not one."""
    if normalize:
        largest = max(abs(value) for value in vector)
        if largest == 0.0:
            problems.add(path, "is the zero vector, which has no direction to normalize")
            return None
        scaled = [value / largest for value in vector]  # first, so that no square over- or underflows
        length = math.hypot(*scaled)
        return [value / length for value in scaled]
    square = sum(value * value for value in vector)
    excess = square - 1.0
    if abs(excess) <= UNIT_TOLERANCE:
        return vector
    name = path[-1]
    problems.add(
        path,
        f"must be a unit vector: {name}² = {square:.15g} is off by {excess:.3g} (allowed: {UNIT_TOLERANCE:g})"
        "; write one component as auto, or set initial.normalize: true",
    )
    return None


def read_columns(
    output: Output, components: Sequence[str], integrals: Sequence[Invariant], problems: Problems
) -> tuple[str, ...] | None:
    """Names of the columns of ``output``, each given by its name or by the symbol that reports print."""
    given = output.columns
    if given is None:
        return None
    plain = {name: name for name in ("n", "t", *components, *output.attitude_columns)}
    names = {text: one.name for one in integrals for text in spellings(one.name, one.symbol)} | plain
    found: list[str] = []
    for text in given:
        name = names.get(text)
        form = next((form for form, columns in ATTITUDES.items() if text in columns), None)
        if name is None and form:
            problems.add(("output", "columns"), f"{quoted(text)} needs output.attitude: {form}")
        elif name is None:
            near = nearest(text, names)
            if near.startswith("known"):
                near = f"known: {', '.join([*plain, *(f'{one.name} ({one.symbol})' for one in integrals)])}"
            problems.add(("output", "columns"), f"unknown column {quoted(text)}; {near}")
        elif name in found:
            problems.add(("output", "columns"), f"names {quoted(name)} twice")
        else:
            found.append(name)
    return tuple(found)
