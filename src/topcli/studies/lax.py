"""``topcli lax``: the Lax forms of a top along the motion and along runs of its schemes."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

from topcli.errors import ExitCode
from topcli.studies import SILENT, Watch
from topcli.studies.study import (
    Data,
    Faults,
    Flag,
    Head,
    Overrides,
    Result,
    Study,
    config_flag,
    parts_of,
    scheme_names,
    top_title,
)
from topcli.table import Column, Table, number


def measure(
    top: Annotated[str, Flag("", "TOP")],
    *schemes: Annotated[str, scheme_names("all except adaptive ones")],
    config: Annotated[str | Path | None, config_flag("a generic state")] = None,
    overrides: Overrides = (),
    watch: Watch = SILENT,
) -> Result:
    """Check Lax forms (pairs L, M) of a top and the spectrum of L.

    A Lax form is a pair of matrices L and M that depend on the state. The study tests the Lax equation dL/dt = [M, L]
    along the motion and measures the drift of the spectrum of L under each scheme. For the Kowalevski top, it also
    tests the discrete Lax equation L' U = U L, where L' is L after a step and U is another matrix.

    Parameters
    ----------
    top : str
        Name of a top.
    *schemes : str
        Names of schemes. By default, all schemes of the top except adaptive ones are tested.
    config : path or str, optional
        Config of the experiment; by default, a generic initial state with h = 0.01 and N = 5000.
    overrides : sequence of str, optional
        Override a key of the config, e.g. h=0.01, top.c0=-1, scheme.branch=sign.
    watch : Watch, optional
        Observer of the study.

    Returns
    -------
    StudyReport
        Report with two tables. ``table`` has a row for each Lax form. ``drifts`` has a row for the exact flow and one
        for each scheme, with the drifts of the spectrum of L.

    Raises
    ------
    UsageError
        If the top or a scheme is unknown, or if the config is for another top.

    Examples
    --------
    >>> import topcli
    >>> report = topcli.lax("euler", "hk", overrides=["N=200"])
    >>> report.table["lax_pair"].to_dict()
    {'3x3': True}
    """
    from topcli.studies.lax_checks import default_schemes, lax_experiment, lax_study

    experiment = lax_experiment(top, config, overrides)
    watch.begin("lax")
    return Result(lax_study(experiment, schemes or default_schemes(experiment)))


def _subject(data: Data) -> str:
    config = data["config"]
    return f"{config['name']}: {top_title(config)}, h = {config['h']:g}, N = {config['N']}"


def _midpoint_order(form: Data) -> str:
    midpoint = form["midpoint"]
    if midpoint["conjugation_defect"] is None:
        return "did not converge"
    return "round-off" if midpoint["order"] is None else f"{midpoint['order']:.2f}"


FORMS = Table(
    "forms",
    (
        Column("size", "size", lambda size: f"{size}x{size}"),
        Column("dL/dt - [M,L] by the equations", "residual_by_field", number),
        Column("dL/dt - [M,L] by differences", "residual_by_differences", number),
        Column("traces", "traces"),
        Column("independent integrals", "independent_integrals"),
        Column("carried integrals", lambda form: ", ".join(form["carries"]) or None, key="carried_integrals"),
        Column("Lax pair", "lax_pair", lambda pair: "yes" if pair else "no"),
        Column("midpoint rule: L' - U L U^-1", "midpoint.conjugation_defect", number, "midpoint_defect"),
        Column("  its order in h", _midpoint_order),
        Column("", "midpoint.order", key="midpoint_order"),
    ),
    heading="Lax forms",
    title=_subject,
    index="form",
    across=Column("", "form"),
)


def _drift_columns(data: Data) -> list[Column]:
    columns = [Column(" ", "scheme")]
    for i, form in enumerate(data["forms"]):
        for head, key, detail in ((form["traces"], "drift", False), ("eigenvalues", "eigenvalue_shift", True)):
            name = f"{form['form']}_{key}"
            columns.append(Column(f"{form['form']}: {head}", f"forms.{i}.{key}", number, name, detail))
    discrete = "L'U - UL" if _discrete(data) else ""
    return [*columns, Column(discrete, "discrete_lax_defect", number)]


def _discrete(data: Data) -> bool:
    return any(run["discrete_lax_defect"] is not None for run in data["runs"])


DRIFTS = Table(
    "runs",
    _drift_columns,
    name="drifts",
    heading="Drift of the spectrum",
    title="largest relative drift of the spectrum of L",
    index="scheme",
)


def head(data: Data) -> Head:
    """Head of the chapter."""
    failed = len(faults(data).lines)
    return Head("Lax forms", _subject(data), f"{failed} failed" if failed else "measured", not failed)


def answer(data: Data) -> str:
    """Forms that are Lax pairs, and the schemes that keep their spectrum best and worst."""
    parts = []
    for i, form in enumerate(data["forms"]):
        if form["lax_pair"]:
            drifts = [(run["forms"][i]["drift"], run["scheme"]) for run in data["runs"][1:]]
            known = sorted((drift, name) for drift, name in drifts if drift is not None)
            ends = " to ".join(f"{number(drift)} ({name})" for drift, name in dict.fromkeys(known[:1] + known[-1:]))
            drifting = f"; under the schemes its {form['traces']} drift by {ends}" if ends else ""
            parts.append(f"{form['form']} is a Lax pair{drifting}")
    return "; ".join(parts)


def notes(data: Data) -> Iterator[str]:
    """Meaning of the discrete Lax pair, and the reason why a form is not a Lax pair."""
    if _discrete(data):
        yield "L'U - UL: defect of the discrete Lax pair of backlund, over the first steps of a run"
    for form in data["forms"]:
        if form["why_not"]:
            yield f"{form['form']}: no Lax pair: {form['why_not']}"


def faults(data: Data) -> Faults:
    """Runs that did not complete."""
    lines = [f"{run['scheme']}: {run['message']}" for run in data["runs"] if run["outcome"] != "completed"]
    return Faults(ExitCode.FAILED if lines else ExitCode.SUCCESS, lines)


LAX = Study(
    "lax",
    measure,
    head,
    (FORMS, DRIFTS),
    answer=answer,
    notes=notes,
    faults=faults,
    parts=lambda data: parts_of(data["config"], [run["scheme"] for run in data["runs"][1:]]),
)
