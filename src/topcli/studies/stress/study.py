"""``topcli stress``: trials of schemes in hard cases, and the outcomes that contradict declared limits."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from textwrap import shorten
from typing import TYPE_CHECKING, Annotated, Any

from topcli.errors import ExitCode, UnknownNameError, UsageError, counted, nearest, quoted
from topcli.studies import SILENT, Watch
from topcli.studies.study import Data, Faults, Flag, Head, Result, Study, config_flag, scheme_names, top_flag
from topcli.table import Column, Table
from topcli.tops import TOPS

if TYPE_CHECKING:
    import pandas as pd


FILE = Path("stress") / "stress.json"


SHOWN_TRIALS = 40
"""List all trials up to this many; beyond it, only a line for each scheme."""
SIGNS = {"held": "·", "degraded": "o", "broke": "X", "not tried": "–"}
MARKS = {"held": "good", "degraded": "middling", "broke": "bad"}
UNEXPLAINED = {
    "unexplained": "breaks without a declared limit",
    "outlived limit": "holds in a case declared as its limit",
}
"""Verdicts on trials that contradict a declaration."""
MEANING = {"ok": "", "limit": "declared limit"}
FAULTS = {"unexplained": "UNDECLARED", "outlived limit": "DECLARED AS A LIMIT"}


def _said(verdict: str) -> str:
    """Verdict in words; in capitals if it is a fault."""
    return MEANING.get(verdict, FAULTS.get(verdict, verdict.upper()))


def _options(texts: Sequence[str]) -> dict[str, Any]:
    """Options of schemes given by ``--set scheme.KEY=VALUE``. Raises UsageError for other keys."""
    from topcli.config.overrides import override_label, parse_override

    options: dict[str, Any] = {}
    for text in texts:
        path, value = parse_override(text)
        if path[0] != "scheme" or len(path) != 2 or path[1] in ("name", "compose"):
            raise UsageError(
                f"{override_label(text)}: set by the case; only options of schemes can be set, as scheme.KEY=VALUE"
            )
        options[str(path[1])] = value
    return options


def _top_of(config: str | Path, top: str | None) -> str:
    """Form of the top of a config, from whose initial state its cases begin. Raises as ``load_experiment``."""
    from topcli.config.load import load_experiment
    from topcli.studies.stress.cases import start_from

    if top is not None:
        raise UsageError(f"--top {quoted(top)}: --config names a top too; give one of them")
    experiment = load_experiment(config)
    start_from(experiment.top, experiment.y0)
    return experiment.top.form


def _case_names() -> list[str]:
    from topcli.studies.stress.cases import case_names

    return case_names()


def measure(
    *schemes: Annotated[str, scheme_names("all")],
    cases: Annotated[Sequence[str], Flag("--case", "CASE", names=_case_names, default="all")] = (),
    top: Annotated[str | None, top_flag("all")] = None,
    config: Annotated[str | Path | None, config_flag("the configs of the hard cases")] = None,
    options: Annotated[Mapping[str, Any] | None, Flag("--set", "KEY=VALUE", read=_options, several=True)] = None,
    watch: Watch = SILENT,
) -> Result:
    """Test schemes in hard cases and find what breaks.

    Hard cases are, for example, motions near singularities, extreme parameters and extreme step sizes. For a list of
    them, use topcli list cases. Only options of schemes, such as branch=sign, can be set; each is set for every scheme
    that has it. A scheme may declare cases that it must fail, its limits. The command exits with code 4 if a scheme
    fails any other case, or passes one of its limits.

    Parameters
    ----------
    *schemes : str
        Names of schemes.
    cases : sequence of str, optional
        Try only these hard cases. By default, all cases are tried; ``topcli list cases`` shows them.
    top : str, optional
        Name of a top; only its schemes and cases are tried.
    config : path or str, optional
        Config of an experiment; the schemes are tested on its top. If topcli has no hard cases for this top, general
        cases are tried, which start from the initial state of the config.
    options : mapping, optional
        Options of schemes by name, such as ``{"branch": "sign"}``. Each option is set for every scheme that has it.
    watch : Watch, optional
        Observer of the study.

    Returns
    -------
    StudyReport
        Report on all trials. A trial is one scheme in one case. ``table`` gives the outcome of each trial and a verdict
        that compares it with the limits that the scheme declares (cases that it must fail). ``unexplained`` contains
        the trials in which a scheme broke without a declared limit, or held in spite of one. ``grid(top)`` is a
        DataFrame of the outcomes for one of the tops (listed in ``tops``), and ``plot(top=...)`` draws it.

    Raises
    ------
    UsageError
        If a scheme, case, top or option is unknown, or if nothing is left to try.

    Examples
    --------
    >>> import topcli
    >>> report = topcli.stress("hk", "backlund", cases=["delone", "pole"])
    >>> report.grid().loc["hk", "pole"]
    'held'
    >>> len(report.table), len(report.unexplained)
    (4, 0)
    """
    from topcli.studies.stress.trials import chosen, require_options, stress, stress_data

    if config is not None:
        top = _top_of(config, top)
    used, _ = chosen(schemes, cases, top)
    require_options(options or {}, used)
    file = None if schemes or cases or top or options else STRESS.file
    watch.begin("stress", file=file)
    return Result(stress_data(stress(schemes, cases, top, options, watch)), file=file)


def _failed(trial: Data) -> bool:
    return trial["outcome"] in ("degraded", "broke") or trial["verdict"] != "ok"


def _contradictions(data: Data) -> list[Data]:
    """Trials that contradict a declaration."""
    return [trial for trial in data["trials"] if trial["verdict"] in UNEXPLAINED]


def _what(trial: Data) -> str:
    """Outcome of a trial, the step at which it failed, and the verdict."""
    outcome = trial["outcome"] if trial["step"] is None else f"{trial['outcome']} at step {trial['step']}"
    return ", ".join(filter(None, (outcome, _said(trial["verdict"]))))


TRIAL = (Column("scheme", "scheme"), Column("top", "top", TOPS.called), Column("case", "case"))
TRIALS = Table(
    "trials",
    (
        *TRIAL,
        Column("outcome", _what),
        *(Column("", key) for key in ("outcome", "step", "verdict")),
        Column("why", "why", lambda why: shorten(why, 100)),
        *(Column("", key) for key in ("limit", "seconds")),
    ),
    keys=3,
    numbers=False,
)
UNEXPLAINED_TRIALS = Table(
    _contradictions,
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
    (Column("case", "case"), Column("top", "top", TOPS.called), Column("question", "question")),
    name="questions",
    heading="Cases",
    keys=2,
    numbers=False,
)


def tops_of(data: Data) -> list[str]:
    """Tops of the trials, in their order."""
    return list(dict.fromkeys(str(trial["top"]) for trial in data["trials"]))


def grid_of(data: Data, top: str) -> Table:
    """Outcomes of the schemes of one top: a row for each scheme, a column for each case."""
    trials = [trial for trial in data["trials"] if trial["top"] == top]
    rows: dict[str, Data] = {}
    for trial in trials:
        rows.setdefault(trial["scheme"], {"scheme": trial["scheme"]})[f"case {trial['case']}"] = trial["outcome"]
    cases = list(dict.fromkeys(trial["case"] for trial in trials))

    def column(case: str) -> Column:
        return Column(case, lambda row: row.get(f"case {case}", ""), lambda outcome: SIGNS.get(outcome, ""))

    meanings = ", ".join(f"{sign} {outcome}" for outcome, sign in SIGNS.items())
    return Table(
        lambda data: list(rows.values()),
        [Column("scheme", "scheme"), *map(column, cases)],
        name=f"grid {top}",
        heading=f"Outcomes: {TOPS.called(top)}",
        caption=f"{meanings}; an empty cell was not run",
        numbers=False,
        marks={SIGNS[outcome]: kind for outcome, kind in MARKS.items()},
    )


def summary_of(data: Data, top: str) -> Table:
    """Cases of one top by outcome: a row for each scheme, or for several of which every case held."""
    cases: dict[str, dict[str, list[str]]] = {}
    for trial in data["trials"]:
        if trial["top"] == top:
            name = trial["case"] + (f" ({_said(trial['verdict'])})" if trial["verdict"] in UNEXPLAINED else "")
            cases.setdefault(trial["scheme"], {}).setdefault(trial["outcome"], []).append(name)
    alike: dict[tuple[Any, ...], list[str]] = {}
    for scheme, found in cases.items():
        held = found.get("held", [])
        others = [", ".join(found.get(outcome, ())) for outcome in SIGNS if outcome != "held"]
        alike.setdefault((len(held), *others), []).append(scheme)
    rows = [{"schemes": names, "cells": key} for key, names in alike.items()]
    shown = [i for i in range(4) if i == 0 or any(row["cells"][i] for row in rows)]
    return Table(
        lambda data: rows,
        [
            Column("scheme", "schemes", ", ".join),
            *(Column(list(SIGNS)[i], lambda row, i=i: row["cells"][i] or None) for i in shown),
        ],
        name=f"summary {top}",
        title=f"{TOPS.called(top)}: cases that did not hold",
        numbers=(1,),
    )


def printed(result: Result, verbose: bool) -> Iterator[Table | str]:
    """Tables on a terminal: a line for each trial, or if there are many, the cases that did not hold by scheme."""
    data = result.data
    yield answer(data)
    if verbose or len(data["trials"]) <= SHOWN_TRIALS:
        yield TRIALS
    else:
        yield from (summary_of(data, top) for top in tops_of(data))


def answer(data: Data) -> str:
    """Numbers of trials by outcome, and of those that contradict a declaration."""
    wrong, limits = len(_contradictions(data)), sum(trial["verdict"] == "limit" for trial in data["trials"])
    outcomes = ", ".join(f"{count} {outcome}" for outcome, count in data["outcomes"].items())
    found = f"{counted(len(data['trials']), 'trial')}: {outcomes}"
    found += f"; {limits} at declared limits" if limits else ""
    return f"{found}; {wrong or 'none'} contradict{'' if wrong > 1 else 's'} what the schemes declare"


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
    wrong = len(_contradictions(data))
    state = f"{wrong} not as declared" if wrong else "as declared"
    return Head("Stress", "schemes in the hard cases of their tops", state, not wrong)


def faults(data: Data) -> Faults:
    """Code that failed, and trials that contradict a declaration."""
    trials = data["trials"]
    failed = [trial for trial in trials if trial["verdict"] == "code failed"]

    def subject(trial: Data) -> str:
        return f"{trial['scheme']} ({TOPS.called(trial['top'])})"

    lines = dict.fromkeys(f"{subject(trial)}: {trial['why']}" for trial in failed)
    wrong = [
        f"{subject(trial)}, case {trial['case']}: {UNEXPLAINED[trial['verdict']]}: {trial['why']}"
        for trial in _contradictions(data)
    ]
    if failed:
        code = ExitCode.PARTLY_FAILED if len(failed) < len(trials) else ExitCode.WRONG_USAGE
    else:
        code = ExitCode.VIOLATED if wrong else ExitCode.SUCCESS
    return Faults(code, [*lines, *wrong])


STRESS = Study(
    "stress",
    measure,
    head,
    lambda data: [*(grid_of(data, top) for top in tops_of(data)), FAILURES, QUESTIONS],
    answer=answer,
    printed=printed,
    frames=(TRIALS, UNEXPLAINED_TRIALS),
    faults=faults,
    figure="topcli.figures.outcomes:loaded_stress",
    draws="the outcome of each scheme in each case",
    plotted="topcli.figures.outcomes:stress_panel",
    stem=lambda data: tops_of(data)[0].replace("/", "-") if len(tops_of(data)) == 1 else "all",
    parts=lambda data: [(trial["top"], str(trial["scheme"]).partition(":")[0]) for trial in data["trials"]],
    unit="trials",
    file=FILE,
    known=lambda data: "trials" in data,
    extras={"tops": lambda result: tops_of(result.data), "grid": grid},
)
