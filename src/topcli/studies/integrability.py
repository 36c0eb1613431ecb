"""``topcli integrability``: computed evidence for or against the integrability of a scheme's map."""

from __future__ import annotations

from typing import Annotated

from topcli.studies import SILENT, Watch
from topcli.studies.study import Config, Data, Flag, Head, Overrides, Result, Study, config_flag
from topcli.table import Column, Table
from topcli.tops import TOPS


def measure(
    top: Annotated[str, Flag("", "TOP")],
    scheme: Annotated[str, Flag("", "SCHEME")] = "hk",
    config: Annotated[Config, config_flag("the default parameters of the top, h = 0.3")] = None,
    overrides: Overrides = (),
    watch: Watch = SILENT,
) -> Result:
    """Collect evidence on the integrability of a scheme's map.

    The study iterates the map from random states. In arithmetic modulo a prime, it measures the growth of the degrees
    of the iterates and searches for independent integrals (from Hirota-Kimura bases) and for invariant densities. With
    exact fractions, it measures how fast the number of digits of the state grows. The step must be a rational function
    of the state: schemes with roots, iterations or decisions that depend on the state are refused.

    Parameters
    ----------
    top : str
        Name of a top, or "custom" for the top that a config defines.
    scheme : str, optional
        Name of a scheme.
    config : path, str or mapping, optional
        Config that gives the parameters of the top and the step size; without it, the default parameters and h = 0.3
        are used.
    overrides : sequence of str, optional
        Override a key of the config, e.g. h=0.01, top.c0=-1, scheme.branch=sign.
    watch : Watch, optional
        Observer of the study.

    Returns
    -------
    StudyReport
        Report on the evidence. ``table`` has a row for each test, with the result, its meaning, and the time in
        seconds. ``study["degrees"]`` contains the degrees of the iterates, ``study["growth"]`` the law of their growth,
        and ``study["verdict"]`` the conclusion.

    Raises
    ------
    UsageError
        If the top or scheme is unknown, or if the step is not a rational function of the state.

    Examples
    --------
    >>> import topcli
    >>> report = topcli.integrability("euler")
    >>> report.study["degrees"][:4], report.study["verdict"]
    ([3, 9, 19, 33], 'integrable')
    """
    from topcli.studies.integrability_evidence import integrability_study, map_experiment

    experiment = map_experiment(top, scheme, config, list(overrides))
    watch.begin("integrability")
    return Result(integrability_study(experiment, watch))


def _subject(data: Data) -> str:
    return f"{data['scheme']} on {TOPS.called(data['top'])}, h = {data['h']:g}"


EVIDENCE = Table(
    "tests",
    (
        Column("test", "test"),
        Column("found", "found"),
        Column("meaning", "meaning"),
        Column("", "seconds"),
    ),
    heading="Evidence",
    title=_subject,
    index="test",
    numbers=False,
)


def head(data: Data) -> Head:
    """Head of the chapter."""
    return Head("Integrability", _subject(data), data["verdict"])


def answer(data: Data) -> str:
    """The verdict with its reason, and what it is worth."""
    return f"{data['verdict']}: {data['why']}; this is computed evidence for these parameters, not a proof"


INTEGRABILITY = Study(
    "integrability",
    measure,
    head,
    (EVIDENCE,),
    answer=answer,
    stem=lambda data: f"{data['scheme']}_{data['top']}",
    parts=lambda data: [(data["top"], data["scheme"])],
    unit="tests",
)
