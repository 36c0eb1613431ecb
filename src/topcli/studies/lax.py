"""``topcli lax``: the Lax forms of a top along the motion and along runs of its schemes."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated

from topcli.errors import ExitCode
from topcli.studies import SILENT, Watch
from topcli.studies.study import (
    ConfigFile,
    Data,
    Faults,
    Flag,
    Head,
    Overrides,
    Result,
    SchemeNames,
    Study,
    parts_of,
    top_title,
)
from topcli.table import Column, Table, number


def measure(
    top: Annotated[str, Flag("", "TOP")],
    *schemes: SchemeNames,
    config: ConfigFile = None,
    overrides: Overrides = (),
    watch: Watch = SILENT,
) -> Result:
    """Check the Lax forms of a top and the spectrum of L.

    Test dL/dt = [M, L] along the motion, and measure the drift of the spectrum of L under each scheme; for the
    Kowalevski top, also the discrete Lax pair L' U = U L.

    Parameters
    ----------
    top : str
        Name of a top.
    *schemes : str
        Names of schemes; all except adaptive ones by default.
    config : path or str, optional
        Read the experiment from a config; by default, a generic state.
    overrides : sequence of str, optional
        Override a key of the config, e.g. h=0.01, top.c0=-1, scheme.branch=sign.
    watch : Watch, optional
        Observer of the study.

    Returns
    -------
    StudyReport
        ``table`` has a row for each Lax form, ``drifts`` one for the exact flow and each scheme.

    Raises
    ------
    UsageError
        For an unknown top or scheme, and for a config of another top.

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
        for head, key in ((form["traces"], "drift"), ("eigenvalues", "eigenvalue_shift")):
            columns.append(Column(f"{form['form']}: {head}", f"forms.{i}.{key}", number, f"{form['form']}_{key}"))
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


def notes(data: Data) -> Iterator[str]:
    """Meaning of the discrete Lax pair, and the reason why a form is no Lax pair."""
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
    notes=notes,
    faults=faults,
    parts=lambda data: parts_of(data["config"], [run["scheme"] for run in data["runs"][1:]]),
)
