"""Claims of the paper, read from ``claims.yaml``, and ``topcli claims``, which tests them by experiments."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import TYPE_CHECKING, Any

from topcli.errors import ExitCode, UnknownNameError, counted, nearest, quoted
from topcli.studies import SILENT, Watch
from topcli.studies.report import Report, Table
from topcli.table import two_digits

if TYPE_CHECKING:
    from topcli.paper.checks import Measured

FORMULAS = {"difference", "equation", "integrals", "quantity", "corrected"}
"""Parameters of checks that are functions of ``formulas``."""


@dataclass(frozen=True)
class Claim:
    """A checkable statement of the paper, and the check that decides it.

    Attributes
    ----------
    id : str
        Name on the command line.
    section, source : str
        Part of the paper, and the section and equation.
    statement : str
        The statement, a sentence.
    check : mapping
        The ``kind`` of the check, a function of ``checks``, after ``not`` for the opposite, and its parameters.
    recorded : str
        Verdict to compare with; no check sees it.
    reading : str
        How the statement is read.
    slow : bool
        True if left out of the fast subset.
    """

    id: str
    section: str
    statement: str
    source: str
    check: Mapping[str, Any]
    recorded: str
    reading: str = ""
    slow: bool = False

    @property
    def function(self) -> Callable[..., Measured]:
        """Function of the check, whose docstring begins with what is measured."""
        from topcli.paper import checks

        return getattr(checks, self.check["kind"].removeprefix("not ").replace(" ", "_"))

    @property
    def parameters(self) -> dict[str, Any]:
        """Parameters of the function."""
        from topcli.paper import formulas

        sense = {"sense": False} if self.check["kind"].startswith("not ") else {}
        named = {name: getattr(formulas, self.check[name]) for name in FORMULAS if name in self.check}
        return {name: value for name, value in {**self.check, **named, **sense}.items() if name != "kind"}

    def experiment(self) -> str:
        """The formula in words, and the commands of the runs."""
        from topcli.paper.checks import settings

        scenes = [self.check[name] for name in ("scene", "other") if name in self.check]
        runs = map(settings, (*scenes, *self.check.get("scenes", ()), *self.check.get("others", ())))
        commands = [" ".join([f"topcli run {config}", *(f"--set {text}" for text in sets)]) for config, sets in runs]
        return "; ".join([*(first_line(value) for value in self.parameters.values() if callable(value)), *commands])


def first_line(function: Callable[..., Any]) -> str:
    """First line of a docstring without its full stop."""
    return str(function.__doc__).partition("\n")[0].removesuffix(".")


@cache
def _document() -> dict[str, Any]:
    from ruamel.yaml import YAML

    return YAML(typ="safe", pure=True).load(files("topcli.paper").joinpath("claims.yaml").read_text(encoding="utf-8"))


def all_claims() -> Mapping[str, Claim]:
    """All claims by name, in the order of the paper."""
    sections = _document()["sections"].items()
    return {id: Claim(id, title, **entry) for title, entries in sections for id, entry in entries.items()}


def excluded() -> list[tuple[str, str, str, str]]:
    """Statements that no experiment decides: name, statement, source, and the reason."""
    return [(id, entry["statement"], entry["source"], entry["reason"]) for id, entry in _document()["excluded"].items()]


def chosen(ids: Sequence[str], fast: bool) -> list[Claim]:
    """Claims with these names, in the order of the paper; by default all, with ``fast`` those that are not slow.

    Raises UnknownNameError with the nearest names.
    """
    ledger, named = all_claims(), [name.lower() for name in ids]
    for name in named:
        if name not in ledger:
            hint = nearest(name, ledger)
            hint = hint if hint.startswith("did you mean") else "topcli claims --fast --verbose lists the claims"
            raise UnknownNameError(f"unknown claim {quoted(name)}; {hint}")
    return [claim for claim in ledger.values() if (claim.id in named if named else not (fast and claim.slow))]


def claims(*ids: str, fast: bool = False, watch: Watch = SILENT) -> Report:
    """Test the claims of the paper by experiments.

    The command exits with code 4 if the verdict on a claim differs from the recorded one.

    Parameters
    ----------
    *ids : str
        Names of the claims to test, such as "hybrid-reversible"; by default all.
    fast : bool, optional
        Skip claims that take longer than a few tenths of a second. Claims that are named are never skipped.
    watch : Watch, optional
        Observer of the study.

    Returns
    -------
    Report
        The first table has a row for each claim with its verdict, the measured number and its bound. The second has
        those that do not hold as stated. The third says what is measured, by which experiment, and why the bound is
        what it is.

    Raises
    ------
    UnknownNameError
        If ``ids`` contains an unknown name. The message gives the nearest names.
    RunError
        If a run fails.

    Examples
    --------
    >>> import topcli
    >>> report = topcli.claims("hybrid-k-sq", "hybrid-reversible")
    >>> report.table["verdict"].tolist()
    ['holds', 'does not hold as stated']
    """
    tested = chosen(ids, fast)
    watch.begin("claims", unit="claims")
    rows, experiments, changed = [], [], []
    for done, claim in enumerate(tested, 1):
        measured = claim.function(**claim.parameters)
        rows.append({
            "id": claim.id, "verdict": measured.verdict, "measured": measured.figure, "bound": measured.bound,
            "statement": claim.statement, "source": claim.source,
        })  # fmt: skip
        experiments.append({
            "id": claim.id, "measures": first_line(claim.function), "bound from": measured.reason,
            "note": "; ".join(filter(None, (claim.reading, measured.note))), "corrected": measured.corrected,
            "experiment": claim.experiment(),
        })  # fmt: skip
        if measured.verdict != claim.recorded:
            changed.append(f"{claim.id}: the verdict is {measured.verdict!r}; recorded: {claim.recorded!r}")
        watch(done, len(tested))
    formats = {"measured": two_digits, "corrected": two_digits}
    counts = Counter(row["verdict"] for row in rows).most_common()
    exceptions = [] if ids else [row for row in rows if not row["verdict"].startswith("holds")]
    return Report(
        "claims",
        "Claims of the paper, each with the measured number that decides it and its bound",
        f"{counted(len(rows), 'claim')} of the paper: {', '.join(f'{verdict} {count}' for verdict, count in counts)}",
        (
            Table("Claims", rows, formats, detail=not ids),
            Table("Claims that do not hold as stated", exceptions, formats, detail=["source"]),
            Table("Experiments", experiments, formats, detail=not ids),
        ),
        errors=changed,
        code=ExitCode.VIOLATED if changed else ExitCode.SUCCESS,
    )
