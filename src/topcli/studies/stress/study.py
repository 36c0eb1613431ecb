"""``topcli stress``: schemes in hard cases, how their outcomes are shown, and which of them are faults."""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from textwrap import shorten
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

from topcli.config.files import override_label, parse_override
from topcli.contracts import Scheme
from topcli.engine.fingerprint import fingerprint
from topcli.errors import (
    ConfigError,
    RunError,
    SchemeCodeError,
    StepTooLongError,
    UnknownNameError,
    UsageError,
    nearest,
    quoted,
    shortened,
)
from topcli.runs.identity import scheme_code
from topcli.schemes.plugins import users_error
from topcli.schemes.registry import all_schemes, find_scheme
from topcli.store.files import stored_study, write_study
from topcli.store.provenance import environment
from topcli.studies import SILENT, Watch
from topcli.studies.stress.cases import CASES, case_names, cases_named
from topcli.studies.stress.checks import Case, CaseCache, CaseOutcome, Finding, Trial, false_order
from topcli.studies.study import Data, Faults, Flag, Head, Result, SchemeNames, Study, TopName
from topcli.table import Column, Table
from topcli.tops import TOPS, forms

if TYPE_CHECKING:
    import pandas as pd


GENERIC = "backwards"
"""Case of every top whose motion is a generic one with a short step: there every scheme has its order."""
CODE_FAILED = "code failed"


@dataclass(frozen=True)
class Judged:
    """The finding of a trial and its verdict.

    ``verdict`` is ``"limit"`` if the scheme broke as it declares, ``"unexplained"`` if it broke without declaring it,
    ``"outlived limit"`` if it declares a limit and did not break, ``"code failed"`` if its code raised or could not be
    compiled, and ``"ok"`` otherwise.
    """

    case: Case
    scheme: Scheme
    finding: Finding
    verdict: str
    limit: str
    counters: Mapping[str, int]
    seconds: float

    def as_dict(self) -> dict[str, Any]:
        """Return plain data, ready for JSON."""
        return {
            "scheme": self.scheme.name,
            "top": self.scheme.top,
            "case": self.case.name,
            "outcome": self.finding.result.value,
            "step": self.finding.step,
            "why": self.finding.why,
            "verdict": self.verdict,
            "limit": self.limit or None,
            "figures": {key: value if np.isfinite(value) else None for key, value in self.finding.figures.items()},
            "counters": dict(self.counters),
            "seconds": self.seconds,
        }


def verdict_of(scheme: Scheme, case: str, result: CaseOutcome) -> str:
    """Verdict on the result of a case, given the limits that the scheme declares.

    A composed scheme has the limits of its base but need not reach them.
    """
    declared = case in scheme.limits
    if result is CaseOutcome.BROKE:
        return "limit" if declared else "unexplained"
    return "outlived limit" if declared and "+" not in scheme.name else "ok"


def tried(
    case: Case,
    scheme: Scheme,
    cache: CaseCache,
    options: Mapping[str, Any] | None = None,
    generic: Case | None = None,
) -> Judged:
    """Try one scheme in one case.

    An order that is lost in the ``generic`` case of the top as well, if that is given, counts as a false declaration.
    """
    start = time.perf_counter()
    counters: Mapping[str, int] = {}
    failed, known = False, scheme.options.model_fields
    given = {key: value for key, value in (options or {}).items() if key in known}
    try:
        trial = Trial(case, case.experiment(scheme.name, given), cache)
        with np.errstate(all="ignore"):
            finding = case.check(trial)
            if generic is not None and finding.result is CaseOutcome.DEGRADED and "order" in finding.figures:
                why = false_order(Trial(generic, generic.experiment(scheme.name, given), cache))
                if why:
                    finding = replace(finding, result=CaseOutcome.BROKE, why=f"on a generic motion {why}")
        counters = trial.counters
    except (StepTooLongError, RunError) as error:
        finding = Finding(CaseOutcome.BROKE, f"refused: {str(error).splitlines()[0]}", 0)
    except ConfigError:
        raise
    except (ArithmeticError, ValueError) as error:
        # the interpreter may raise where machine code returns inf or nan
        finding = Finding(CaseOutcome.BROKE, f"failed: {type(error).__name__}: {error}".splitlines()[0], 0)
    except Exception as error:
        known_error = error if isinstance(error, SchemeCodeError) else users_error(error)
        if known_error is None:
            raise
        finding, failed = Finding(CaseOutcome.BROKE, str(known_error), 0), True
    limit = scheme.limits.get(case.name, "")
    verdict = CODE_FAILED if failed else verdict_of(scheme, case.name, finding.result)
    return Judged(case, scheme, finding, verdict, limit, counters, time.perf_counter() - start)


def generic_case(form: str) -> Case:
    """Case of a top on whose motion every scheme has its order."""
    return next(case for case in CASES if case.form == form and case.name == GENERIC)


def chosen(schemes: Sequence[str], cases: Sequence[str], top: str | None) -> tuple[list[Scheme], list[Case]]:
    """Return the schemes and cases to try; all if none is named.

    Raises UnknownNameError for unknown names, and UsageError if nothing is left to try.
    """
    fits = [form.form for form in forms(top)] if top else list(TOPS)
    wanted = [case for name in dict.fromkeys(cases) for case in cases_named(name)] if cases else list(CASES)
    wanted = [case for case in wanted if case.form in fits]
    if not wanted and not cases:
        known = sorted({case.form for case in CASES})
        raise UsageError(f"the top {shortened(str(top))} has no hard cases; those with cases: {', '.join(known)}")
    if not wanted:
        raise UsageError(f"--case {shortened(cases[0])}: no such case for {top}; {nearest(cases[0], _names_for(fits))}")
    used: list[Scheme] = []
    if schemes:
        for name in dict.fromkeys(name.lower() for name in schemes):
            used += _forms_of(name, fits)
    else:
        used = [scheme for scheme in all_schemes() if scheme.top in fits]
    asked = {case.form for case in wanted}
    used = [scheme for scheme in used if scheme.top in asked]
    if not used:
        raise UsageError(
            f"none of the schemes {shortened(', '.join(schemes))} has one of the cases; see topcli list cases"
        )
    return used, wanted


def require_options(options: Iterable[str], schemes: Iterable[Scheme]) -> None:
    """Raise UsageError for an option that none of the schemes has."""
    known = {name for scheme in schemes for name in scheme.options.model_fields}
    for key in options:
        if key not in known:
            raise UsageError(
                f"--set scheme.{shortened(key)}: none of the schemes has this option; {nearest(key, known)}"
            )


def _names_for(fits: Collection[str]) -> list[str]:
    return [name for name in case_names() if any(case.form in fits for case in cases_named(name))]


def _forms_of(name: str, fits: Sequence[str]) -> list[Scheme]:
    """Return the schemes called ``name``, one for each form that it steps. Raises UnknownNameError or UsageError."""
    base = name.partition("+")[0]
    steps = {scheme.top for scheme in all_schemes() if scheme.name == base}
    found = [find_scheme(name, form) for form in fits if form in steps]
    # the error of a name that is unknown, or of a scheme for another top
    return found or [find_scheme(name, fits[0])]


def stress(
    schemes: Sequence[str] = (),
    cases: Sequence[str] = (),
    top: str | None = None,
    options: Mapping[str, Any] | None = None,
    on_progress: Callable[[int, int], None] = lambda done, total: None,
) -> list[Judged]:
    """Try every chosen scheme in every chosen case of its top, in the order of the registry.

    Each of ``options`` is set for the schemes that have it. Raises UsageError for unknown schemes, cases and tops.
    """
    used, wanted = chosen(schemes, cases, top)
    pairs = [(case, scheme) for scheme in used for case in wanted if case.form == scheme.top]
    cache = CaseCache()
    done: list[Judged] = []
    for case, scheme in pairs:
        done.append(tried(case, scheme, cache, options, generic_case(case.form)))
        on_progress(len(done), len(pairs))
    return done


FILE = Path("stress") / "stress.json"
SCHEMA_VERSION = 1


def stress_data(judged: Sequence[Judged]) -> dict[str, Any]:
    """Return the study as plain data: the cases, the trials, and the number of each outcome and verdict."""
    asked = {(one.case.name, one.case.form): one.case for one in judged}
    outcomes = [one.finding.result.value for one in judged]
    verdicts = [one.verdict for one in judged]
    return {
        "schema_version": SCHEMA_VERSION,
        "cases": [{"case": case.name, "top": case.form, "question": case.question} for case in asked.values()],
        "trials": [one.as_dict() for one in judged],
        "outcomes": {value: outcomes.count(value) for value in dict.fromkeys(outcomes)},
        "verdicts": {value: verdicts.count(value) for value in dict.fromkeys(verdicts)},
        "environment": environment(),
    }


def stress_source() -> str:
    """Digest of everything that the results of the whole suite depend on: the code and limits of schemes and cases."""
    schemes = []
    for scheme in all_schemes():
        code = scheme_code(scheme, TOPS[scheme.top].new())
        schemes.append([scheme.name, scheme.top, code, sorted(scheme.limits.items())])
    checks = [
        [case.name, case.form, case.question, fingerprint(case.check, case.config, compiled=False)] for case in CASES
    ]
    text = json.dumps([schemes, checks, fingerprint(tried, false_order, compiled=False)])
    return hashlib.sha256(text.encode()).hexdigest()


def write_stress(data: dict[str, Any], out: Path, source: str | None) -> Path:
    """Write the study to ``out/stress/stress.json`` atomically and return its path.

    ``source`` is the digest of the whole suite; None for a part of it. Raises UsageError and RunError.
    """
    return write_study(out / FILE, data, source)


def stored_stress(out: Path) -> dict[str, Any] | None:
    """Return the study stored in ``out/stress``; None if there is none. Raises RunError if it is damaged."""
    return stored_study(out / FILE, SCHEMA_VERSION, "topcli stress")


SHOWN = 40
"""List all trials up to this many; beyond it, only failures."""
SIGNS = {"held": "·", "degraded": "o", "broke": "X", "not tried": "–"}
MARKS = {"held": "good", "degraded": "middling", "broke": "bad"}
UNEXPLAINED = {
    "unexplained": "breaks without a declared limit",
    "outlived limit": "holds in a case declared as its limit",
}
"""Verdicts on trials that contradict a declaration."""
MEANING = {"ok": "", "limit": "declared limit"}


def _options(texts: Sequence[str]) -> dict[str, Any]:
    """Options of schemes given by ``--set scheme.KEY=VALUE``. Raises UsageError for other keys."""
    options: dict[str, Any] = {}
    for text in texts:
        path, value = parse_override(text)
        if path[0] != "scheme" or len(path) != 2 or path[1] in ("name", "compose"):
            raise UsageError(f"{override_label(text)}: only options of schemes can be set, as scheme.KEY=VALUE")
        options[str(path[1])] = value
    return options


def measure(
    *schemes: SchemeNames,
    cases: Annotated[Sequence[str], Flag("--case", "CASE", names=case_names)] = (),
    top: TopName = None,
    options: Annotated[Mapping[str, Any] | None, Flag("--set", "KEY=VALUE", read=_options, several=True)] = None,
    watch: Watch = SILENT,
) -> Result:
    """Test schemes in hard cases and find what breaks.

    Exits with status 4 if a scheme breaks without a declared limit, or holds in a case that it declares as its limit;
    with 3 if the code of some of the schemes fails.

    Parameters
    ----------
    *schemes : str
        Names of schemes; all by default.
    cases : sequence of str, optional
        Try only this case; repeat for several. All by default; ``topcli list cases`` shows them.
    top : str, optional
        Try only schemes and cases of this top.
    options : mapping, optional
        Set an option for all schemes that have it, e.g. scheme.branch=sign.
    watch : Watch, optional
        Observer of the study.

    Returns
    -------
    StudyReport
        ``table`` has a row for each trial, with its outcome and its verdict in view of the limits that the scheme
        declares; ``unexplained`` those of them that broke without a declared limit, or held in spite of one.
        ``grid(top)`` is a DataFrame of the outcomes of one of the ``tops``, and ``plot(top=...)`` draws it.

    Raises
    ------
    UsageError
        For unknown schemes, cases, tops and options, or if nothing is left to try.

    Examples
    --------
    >>> import topcli
    >>> report = topcli.stress("hk", "dg4", cases=["delone", "pole"])
    >>> report.grid().loc["hk", "pole"]
    'held'
    >>> len(report.table), len(report.unexplained)
    (4, 0)
    """
    used, _ = chosen(schemes, cases, top)
    require_options(options or {}, used)
    file = None if schemes or cases or top or options else STRESS.file
    watch.begin("stress", file=file)
    return Result(stress_data(stress(schemes, cases, top, options, watch)), source=stress_source, file=file)


def _failed(trial: Data) -> bool:
    return trial["outcome"] in ("degraded", "broke") or trial["verdict"] != "ok"


def _what(trial: Data) -> str:
    return trial["outcome"] if trial["step"] is None else f"{trial['outcome']} at step {trial['step']}"


TRIAL = (Column("scheme", "scheme"), Column("top", "top"), Column("case", "case"))
TRIALS = Table(
    "trials",
    (
        *TRIAL,
        Column("outcome", _what),
        *(Column("", key) for key in ("outcome", "step", "verdict")),
        Column("why", "why", lambda why: shorten(why, 100)),
        *(Column("", key) for key in ("limit", "seconds")),
        Column(" ", lambda trial: MEANING.get(trial["verdict"], trial["verdict"].upper())),
    ),
    keys=3,
    numbers=False,
)
UNEXPLAINED_TRIALS = Table(
    lambda data: [trial for trial in data["trials"] if trial["verdict"] in UNEXPLAINED],
    TRIALS.columns,
    name="unexplained",
)
FAILURES = Table(
    lambda data: [trial for trial in data["trials"] if _failed(trial)],
    (
        *TRIAL,
        Column("outcome", "outcome"),
        Column("step", "step"),
        Column("why", "why"),
        Column("verdict", lambda trial: MEANING.get(trial["verdict"], trial["verdict"])),
    ),
    name="failures",
    heading="Trials that did not hold",
    keys=3,
    numbers=False,
    marks=MARKS | dict.fromkeys(UNEXPLAINED, "bad"),
)
QUESTIONS = Table(
    "cases",
    tuple(Column(key, key) for key in ("case", "top", "question")),
    name="questions",
    heading="Cases",
    keys=2,
    numbers=False,
)


def tops_of(data: Data) -> list[str]:
    """Tops of the trials, in their order."""
    return list(dict.fromkeys(str(trial["top"]) for trial in data["trials"]))


def grid_of(data: Data, top: str, numbered: bool = False) -> Table:
    """Outcomes of the schemes of one top: a row for each scheme, a column for each case, ``numbered`` or named."""
    trials = [trial for trial in data["trials"] if trial["top"] == top]
    rows: dict[str, Data] = {}
    for trial in trials:
        rows.setdefault(trial["scheme"], {"scheme": trial["scheme"]})[f"case {trial['case']}"] = trial["outcome"]
    cases = list(dict.fromkeys(trial["case"] for trial in trials))
    signs = {**SIGNS, "not tried": ""} if numbered else SIGNS

    def column(number: int, case: str) -> Column:
        head = str(number) if numbered else case
        return Column(head, lambda row: row.get(f"case {case}", ""), lambda outcome: signs.get(outcome, ""))

    listed = "  " + ", ".join(f"{number}={case}" for number, case in enumerate(cases, 1))
    meanings = ", ".join(f"{sign} {outcome}" for outcome, sign in SIGNS.items())
    return Table(
        lambda data: list(rows.values()),
        [Column(top if numbered else "scheme", "scheme"), *(column(i, case) for i, case in enumerate(cases, 1))],
        name=f"grid {top}",
        heading=f"Outcomes: {top}",
        caption=listed if numbered else f"{meanings}; no sign: not run",
        numbers=numbered,
        marks={SIGNS[outcome]: kind for outcome, kind in MARKS.items()},
    )


def printed(data: Data, *, verbose: Annotated[bool, Flag("--verbose -v")] = False) -> Iterator[Table | str]:
    """Tables on a terminal: grids of the outcomes of many trials, then a line for each trial that did not hold.

    Parameters
    ----------
    verbose : bool, optional
        List trials that held as well.
    """
    every = verbose or len(data["trials"]) <= SHOWN
    if not every:
        for top in tops_of(data):
            yield grid_of(data, top, numbered=True)
        yield "· held   o degraded   X broke   (blank: not tried, or not a case of the top)"
    yield TRIALS if every else Table(FAILURES.rows, TRIALS.columns, keys=3, numbers=False)


def grid(result: Result) -> Callable[..., pd.DataFrame]:
    """Function of a top, by default the first, that returns its outcomes: schemes down, cases across."""

    def of(top: str | None = None) -> pd.DataFrame:
        import pandas as pd

        wanted = known_top(result.data, top)
        trials = pd.DataFrame([trial for trial in result.data["trials"] if trial["top"] == wanted])
        shaped = trials.pivot(index="scheme", columns="case", values="outcome")
        return shaped.reindex(index=trials["scheme"].unique(), columns=trials["case"].unique())

    return of


def known_top(data: Data, top: str | None) -> str:
    """``top``, by default the first. Raises UnknownNameError if there are no trials of it."""
    tops = tops_of(data)
    if top is not None and top not in tops:
        raise UnknownNameError(f"no trials of the top {quoted(top)}; {nearest(top, tops)}")
    return top or tops[0]


def head(data: Data) -> Head:
    """Head of the chapter."""
    wrong = sum(trial["verdict"] in UNEXPLAINED for trial in data["trials"])
    state = f"{wrong} unexplained" if wrong else "as declared"
    return Head("Stress", "schemes in the hard cases of their tops", state, not wrong, _counts(data))


def _counts(data: Data) -> str:
    return ", ".join(f"{count} {outcome}" for outcome, count in data["outcomes"].items())


def notes(data: Data) -> Iterator[str]:
    """Number of each outcome."""
    limits = data["verdicts"].get("limit", 0)
    yield _counts(data) + (f"; {limits} of the failures are declared limits" if limits else "")


def faults(data: Data) -> Faults:
    """Code that failed, and trials that contradict a declaration."""
    trials = data["trials"]
    failed = [trial for trial in trials if trial["verdict"] == "code failed"]
    lines = dict.fromkeys(f"{trial['scheme']} ({trial['top']}): {trial['why']}" for trial in failed)
    wrong = [
        f"{trial['scheme']} ({trial['top']}), case {trial['case']}: {UNEXPLAINED[trial['verdict']]}: {trial['why']}"
        for trial in trials
        if trial["verdict"] in UNEXPLAINED
    ]
    code = (3 if len(failed) < len(trials) else 2) if failed else 4 if wrong else 0
    return Faults(code, [*lines, *wrong])


STRESS = Study(
    "stress",
    measure,
    head,
    lambda data: [*(grid_of(data, top) for top in tops_of(data)), FAILURES, QUESTIONS],
    printed=printed,
    frames=(TRIALS, UNEXPLAINED_TRIALS),
    notes=notes,
    faults=faults,
    plotted="topcli.figures.outcomes:stress_panel",
    parts=lambda data: [(trial["top"], str(trial["scheme"]).partition(":")[0]) for trial in data["trials"]],
    unit="trials",
    file=FILE,
    hint="; draw it with: topcli plot stress",
    known=lambda data: "trials" in data,
    extras={"tops": lambda result: tops_of(result.data), "grid": grid},
)
