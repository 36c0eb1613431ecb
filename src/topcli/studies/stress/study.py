"""``topcli stress``: schemes in hard cases, how their outcomes are shown, and which of them are faults."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from textwrap import shorten
from typing import TYPE_CHECKING, Annotated, Any

from topcli.errors import (
    ExitCode,
    UnknownNameError,
    UsageError,
    nearest,
    quoted,
)
from topcli.studies import SILENT, Watch
from topcli.studies.study import ConfigFile, Data, Faults, Flag, Head, Result, SchemeNames, Study, TopName
from topcli.table import Column, Table

if TYPE_CHECKING:
    import pandas as pd


FILE = Path("stress") / "stress.json"


SHOWN_TRIALS = 40
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
    from topcli.config.files import override_label, parse_override

    options: dict[str, Any] = {}
    for text in texts:
        path, value = parse_override(text)
        if path[0] != "scheme" or len(path) != 2 or path[1] in ("name", "compose"):
            raise UsageError(f"{override_label(text)}: only options of schemes can be set, as scheme.KEY=VALUE")
        options[str(path[1])] = value
    return options


def _top_of(config: str | Path, top: str | None) -> str:
    """Form of the top of a config, from whose initial state its cases begin. Raises as ``load_experiment``."""
    from topcli.config.load import load_experiment
    from topcli.studies.stress.cases import start_from

    if top is not None:
        raise UsageError(f"--top {quoted(top)}: --config names a top too; keep one of them")
    experiment = load_experiment(config)
    start_from(experiment.top, experiment.y0)
    return experiment.top.form


def _case_names() -> list[str]:
    from topcli.studies.stress.cases import case_names

    return case_names()


def measure(
    *schemes: SchemeNames,
    cases: Annotated[Sequence[str], Flag("--case", "CASE", names=_case_names)] = (),
    top: TopName = None,
    config: ConfigFile = None,
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
    config : path or str, optional
        Try the top of this config. A top without cases of its own starts from the initial state of the config.
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
    from topcli.studies.stress.trials import chosen, require_options, stress, stress_data, stress_source

    if config is not None:
        top = _top_of(config, top)
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


def printed(result: Result, *, verbose: Annotated[bool, Flag("--verbose -v")] = False) -> Iterator[Table | str]:
    """Tables on a terminal: grids of the outcomes of many trials, then a line for each trial that did not hold.

    Parameters
    ----------
    verbose : bool, optional
        List trials that held as well.
    """
    data = result.data
    every = verbose or len(data["trials"]) <= SHOWN_TRIALS
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
