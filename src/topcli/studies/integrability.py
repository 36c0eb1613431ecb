"""``topcli integrability``: computed evidence for or against the integrability of a scheme's map."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated

from topcli.studies import SILENT, Watch
from topcli.studies.study import ConfigSource, Data, Flag, Head, Overrides, Result, Study
from topcli.table import Column, Table


def measure(
    top: Annotated[str, Flag("", "TOP")],
    scheme: Annotated[str, Flag("", "[SCHEME]")] = "hk",
    config: ConfigSource = None,
    overrides: Overrides = (),
    watch: Watch = SILENT,
) -> Result:
    """Collect evidence on the integrability of a scheme's map.

    The step is taken modulo a prime, on random states: degrees of its iterates along a line and their recurrence,
    independent integrals from HK bases, and invariant densities; and in rational numbers: the growth of their length.
    Its formula must be rational: schemes with roots, with iterations and with decisions on the state are refused.

    Parameters
    ----------
    top : str
        Name of a top; "custom" with a config.
    scheme : str, optional
        Name of a scheme.
    config : path, str or mapping, optional
        Take top and step size from a config; by default, default parameters and h = 0.3.
    overrides : sequence of str, optional
        Override a key of the config, e.g. h=0.01, top.c0=-1, scheme.branch=sign.
    watch : Watch, optional
        Observer of the study.

    Returns
    -------
    StudyReport
        ``table`` has a row for each test: what it found, what that means, and its seconds. ``study["degrees"]``,
        ``study["growth"]`` and ``study["verdict"]`` are plain data.

    Raises
    ------
    UsageError
        For an unknown top or scheme, and for a step that is no rational function of the state.

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
    return f"{data['scheme']} on {data['top']}, h = {data['h']:g}"


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


def notes(data: Data) -> Iterator[str]:
    """The verdict with its reason, and what it is worth."""
    yield f"{data['verdict']}: {data['why']}"
    yield "computed evidence for these parameters, not a proof"


INTEGRABILITY = Study(
    "integrability",
    measure,
    head,
    (EVIDENCE,),
    notes=notes,
    stem=lambda data: f"{data['scheme']}_{data['top']}",
    parts=lambda data: [(data["top"], data["scheme"])],
    unit="tests",
)
