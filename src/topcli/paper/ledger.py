"""Ledger of the paper's claims: ``ledger.yaml`` as data, and the selection of claims by name."""

from __future__ import annotations

import inspect
import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from functools import cache, partial
from importlib.resources import files
from typing import Annotated, Any, Literal, get_type_hints

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    ValidationError,
    ValidationInfo,
    create_model,
    model_validator,
)

from topcli.config.text import parse_yaml
from topcli.errors import ConfigError, UnknownNameError, nearest, quoted
from topcli.paper import exact_checks, run_checks
from topcli.paper.claim import Bound, Measurement
from topcli.paper.scenes import AND_VARIED, LedgerScene

FILE = "ledger.yaml"


class LedgerEntry(BaseModel):
    """Part of the ledger, without further keys."""

    model_config = ConfigDict(extra="forbid", frozen=True, hide_input_in_errors=True)


@cache
def _function(name: str) -> tuple[Callable[..., Measurement], type[BaseModel]]:
    """Function of a check, and the model of its parameters that follows from its annotations."""
    for module in (exact_checks, run_checks):
        if function := vars(module).get(name):
            hints = get_type_hints(function, include_extras=True)
            fields: dict[str, Any] = {
                parameter.name: (
                    hints[parameter.name],
                    ... if parameter.default is parameter.empty else parameter.default,
                )
                for parameter in inspect.signature(function).parameters.values()
            }
            return function, create_model(name, __config__=LedgerEntry.model_config, **fields)
    raise ValueError(f"no check function {name!r}")


class Check(LedgerEntry):
    """A kind of check: a function that measures a figure, and the bound of the figure of a true statement.

    ``control`` holds the parameters of a known ``defect``, on which the verdict must be "does not hold as stated".
    """

    name: str
    function: str
    fixed: dict[str, Any] = Field({}, description="parameters of the function that this kind of check fixes")
    measures: str = Field(description="meaning of the figure")
    side: Literal["at most", "at least", "above", "equal", "near"] = Field(
        description="position of the figure of a true statement relative to the limit"
    )
    limit: float | None = Field(None, description="limit, if the function does not return it")
    reason: str = Field("", description="theory that the limit comes from, if the function does not return it")
    unit: str = ""
    approximate: bool = Field(False, description='true if the statement is itself approximate ("very small")')
    defect: str
    control: dict[str, Any]
    experiment: str = Field("", description="experiment of the claims that do not describe their own")

    @model_validator(mode="after")
    def _control_fits(self, info: ValidationInfo) -> Check:
        self.bind(self.control)
        _known(info)[self.name] = self
        return self

    def bind(self, parameters: Mapping[str, Any]) -> Callable[[], Measurement]:
        """Return the function with these parameters. Raises ValueError if they do not fit."""
        function, model = _function(self.function)
        try:
            read = model.model_validate({**self.fixed, **parameters})
        except ValidationError as error:
            raise ValueError("; ".join(_explained(mistake) for mistake in error.errors())) from None
        return partial(function, **{name: getattr(read, name) for name in read.model_fields_set})

    def bound(self, measured: Measurement, parameters: Mapping[str, Any]) -> Bound:
        """Bound of the figure of a true statement."""
        limit = self.limit if measured.limit is None else measured.limit
        assert limit is not None
        low, high = {
            "at most": (0.0, limit),
            "at least": (limit, math.inf),
            "above": (limit, math.inf),
            "equal": (limit, limit),
            "near": (limit - run_checks.TOLERANCE, limit + run_checks.TOLERANCE),
        }[self.side]
        reason = measured.reason or self.reason.format(**parameters)
        return Bound(low, high, reason, measured.unit or self.unit, self.approximate, self.side == "above")


def _known(info: ValidationInfo) -> dict[str, Check]:
    """Checks read so far."""
    assert info.context is not None
    return info.context


def _known_check(name: Any, info: ValidationInfo) -> Check:
    checks = _known(info)
    if name not in checks:
        raise ValueError(f"unknown check {name!r}; {nearest(str(name), checks)}")
    return checks[name]


class Claim(LedgerEntry):
    """A checkable statement and the experiment that decides it.

    A claim is decided on the paper's own scope: its figure, initial state, window, step and symbols.
    """

    id: str = Field(pattern="^[a-z0-9]+(-[a-z0-9]+)*$", description="name on the command line")
    statement: str = Field(pattern=r"\.$")
    source: str = Field(pattern="^section", description="section and equation")
    check: Annotated[Check, BeforeValidator(_known_check)]
    parameters: dict[str, Any] = Field({}, alias="with", description="parameters of the check")
    experiment: str = Field("", description="one line; names of scenes and commands stand between backticks")
    slow: bool = Field(False, description="true if left out of the fast subset")
    recorded: Literal["holds", "holds within", "does not hold as stated", "misprint"] = Field(
        description="verdict to compare with; no check sees it"
    )

    @model_validator(mode="after")
    def _parameters_fit(self) -> Claim:
        self.check.bind(self.parameters)
        return self

    @property
    def experiment_text(self) -> str:
        """The experiment in a line, with names of scenes and commands between backticks."""
        scene = LedgerScene.read(self.parameters["scene"]).code if "scene" in self.parameters else ""
        return (self.experiment or self.check.experiment).format(
            **self.parameters | {"scene": scene}, varied=AND_VARIED
        )


class Excluded(LedgerEntry):
    """A statement that no experiment decides: its ``source`` in the paper and the ``reason``."""

    id: str
    statement: str
    source: str
    reason: str


class PaperSection(LedgerEntry):
    """Claims of one part of the paper."""

    title: str
    about: str = ""
    claims: tuple[Claim, ...]


class Ledger(LedgerEntry):
    """Kinds of checks, claims in the order of the paper, and what is left out."""

    checks: tuple[Check, ...]
    sections: tuple[PaperSection, ...]
    excluded: tuple[Excluded, ...]

    @model_validator(mode="after")
    def _names_are_unique(self) -> Ledger:
        for name, count in Counter(entry.id for entry in (*self.claims, *self.excluded)).items():
            if count > 1:
                raise ValueError(f"the name {name!r} is used twice")
        return self

    @property
    def claims(self) -> tuple[Claim, ...]:
        """All claims, in order."""
        return tuple(claim for section in self.sections for claim in section.claims)

    def chosen(self, ids: Sequence[str] = (), fast: bool = False) -> list[Claim]:
        """Return the claims to decide, in the order of the ledger; all if none is named.

        With ``fast`` those that are slow are left out unless they are named. Raises UnknownNameError with the nearest
        names.
        """
        known = [claim.id for claim in self.claims]
        wanted = [name.lower() for name in ids]
        for name in ids:
            if name.lower() not in known:
                hint = nearest(name, known)
                hint = hint if hint.startswith("did you mean") else "topcli claims --fast lists the claims"
                raise UnknownNameError(f"unknown claim {quoted(name)}; {hint}")
        return [claim for claim in self.claims if (claim.id in wanted if wanted else not (fast and claim.slow))]


def _explained(mistake: Any) -> str:
    """One of pydantic's errors with the key that it is about."""
    key = [part for part in mistake["loc"][-1:] if isinstance(part, str)]
    return ": ".join([*key, mistake["msg"].removeprefix("Value error, ")])


def read_ledger(text: str, label: str = FILE) -> Ledger:
    """Ledger of a YAML text. Raises ConfigError with the line and the name of each entry that is wrong."""
    data, lines = parse_yaml(text, label)
    try:
        return Ledger.model_validate(data, context={})
    except ValidationError as error:
        raise ConfigError(*(_located(mistake, data, lines, label) for mistake in error.errors()[:3])) from None


def _located(mistake: Any, data: Any, lines: Mapping[Any, int], label: str) -> str:
    """Message about a mistake with its line, and with the name of the entry that it is in."""
    path, name = mistake["loc"], ""
    for depth, part in enumerate(path):
        if part not in data and not isinstance(data, list):
            path = path[:depth]
            break
        data = data[part]
        name = data.get("id", data.get("name", name)) if isinstance(data, dict) else name
    inside = [line for key, line in lines.items() if key[: len(path)] == path]
    return ": ".join(part for part in (f"{label}:{min(inside, default=1)}", name, _explained(mistake)) if part)


@cache
def ledger() -> Ledger:
    """The ledger of the package."""
    return read_ledger(files("topcli.paper").joinpath(FILE).read_text(encoding="utf-8"))


def claim_names() -> list[str]:
    """Names of all claims."""
    return [claim.id for claim in ledger().claims]
