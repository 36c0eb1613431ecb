"""``topcli compare``: schemes, options and steps on one experiment or ensemble, side by side."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Annotated, Any

from topcli.errors import ExitCode, UnknownNameError, UsageError, quoted
from topcli.studies import SILENT, Watch
from topcli.studies.study import PYTHON_ONLY, Data, Faults, Flag, Head, Overrides, Result, Study, cited_parts, top_title
from topcli.table import Column, Table, number

PAPER_SCENE = "kowalevski_hk"


def measure(
    *entries: Annotated[str, Flag("", "SCHEME[:KEY=VALUE,...]", required=True)],
    config: Annotated[str | Path | Mapping[str, Any], Flag("--config", "CONFIG")] = PAPER_SCENE,
    overrides: Overrides = (),
    options: Annotated[Mapping[str, Any] | None, PYTHON_ONLY] = None,
    reference: Annotated[str, Flag("--reference", "KIND")] = "taylor",
    watch: Watch = SILENT,
    **changes: Any,
) -> Result:
    """Compare schemes: errors, drifts, reversal, swings, speed.

    An entry is a scheme with its own options and step: topcli compare hk hk:h=0.01 hybrid:branch=sign. Entries with
    different steps cover the same time and are compared at the times that all of them reach. Of an ensemble, median
    and quantiles over the trajectories are given.

    Parameters
    ----------
    *entries : str
        Name schemes, each with its own h and options. For example ``"hk"``, ``"hk:h=0.02"``, ``"hybrid:branch=sign"``.
    config : path, str or mapping, optional
        Read the experiment from a config or scene. The content of a config serves as well.
    overrides : sequence of str, optional
        Override a key of the config, e.g. h=0.01, top.c0=-1, scheme.branch=sign. An option of schemes is set for all
        that have it. Applied after the ``changes``.
    options : mapping, optional
        Options for all schemes that have them.
    reference : {"taylor", "exact"}, optional
        Take errors from taylor (series) or exact (closed form). The series is in double-double arithmetic.
    watch : Watch, optional
        Observer of the study.
    **changes
        Values that replace whole top-level keys of the config, such as ``h=0.01``.

    Returns
    -------
    StudyReport
        Figures of each entry. Errors are Euclidean norms of the difference of states from the reference, which
        ``figures["reference"]`` names. ``series`` is a DataFrame of the compared times, and of ``error:<entry>`` and
        ``swing:<entry>`` over them; ``plot(what="swing")`` draws the swings instead of the errors.

    Raises
    ------
    ConfigError
        If the config has a fault.
    UsageError
        For unknown schemes or options, for steps without common times, and for a closed form that the top does not
        have.

    Examples
    --------
    >>> import topcli
    >>> report = topcli.compare("hk", "hk:h=0.02", "rk4", config="kowalevski_generic_hk", h=0.01, T=5)
    >>> report
    <StudyReport of kowalevski_generic_hk: completed>
    >>> fine, coarse = report.table["max_error"][["hk", "hk:h=0.02"]]
    >>> bool(3.9 < coarse / fine < 4.1)
    True
    >>> axes = report.plot()
    >>> axes.get_yscale()
    'log'
    """
    from topcli.config.files import is_config
    from topcli.config.load import load
    from topcli.config.models import Experiment
    from topcli.studies.compare_runs import compare_ensemble, compare_schemes
    from topcli.studies.entries import scheme_options

    if not entries:
        raise UsageError("compare: name at least one scheme, as in topcli.compare('hk', 'hybrid')")
    own, others = scheme_options(overrides)
    options = {**(options or {}), **own}
    experiment = load(config, others, changes).of_all_steps()
    try:
        if isinstance(experiment, Experiment):
            watch.begin(experiment.name, experiment)
            return compare_schemes(experiment, entries, options, reference)
        watch.begin(experiment.name, experiment, plotted=f"{experiment.name} is an ensemble of {experiment.count}")
        return Result(compare_ensemble(experiment, entries, options, watch, reference))
    except UnknownNameError as error:
        for entry in entries:
            if quoted(entry) in str(error) and is_config(entry):
                command = f"topcli compare hk hybrid --config {entry}"
                hint = f"{quoted(entry)} is a config, not a scheme; compare schemes on it with: {command}"
                raise UsageError(hint) from error
        raise


def _label(scheme: Data) -> str:
    """Label of an entry, with the options other than the defaults that it does not name."""
    changed = [f"{key}={value}" for key, value in scheme["changed"].items() if key not in scheme["own"]]
    return scheme["label"] + (f" ({', '.join(changed)})" if changed else "")


def _is_ensemble(data: Data) -> bool:
    return data.get("kind") == "ensemble"


def _same_step(data: Data) -> bool:
    return len({scheme["h"] for scheme in data["schemes"]}) == 1


def _title(data: Data) -> str:
    """Experiment, top, steps, or the time if the steps differ, and what is given of an ensemble."""
    config, first = data["config"], data["schemes"][0]
    steps = f"h = {first['h']:g}, N = {first['N']}" if _same_step(data) else f"t from 0 to {first['N'] * first['h']:g}"
    title = f"{config['name']}: {top_title(config)}, {steps}"
    if _is_ensemble(data):
        quantiles = "median, 10 % and 90 % quantiles of those that reached the end"
        return f"{title}, {data['trajectories']} trajectories; {quantiles}"
    return f"{title}, precision {config['precision']}" if "precision" in config else title


def _columns(data: Data) -> list[Column]:
    """Figures of each entry: its settings, and what was measured."""
    sizes = (Column("h", "h", "{:g}".format), Column("N", "N"))
    plain = [Column("", name) for name in ("h", "N")] if _same_step(data) else list(sizes)
    measured = _ensemble_columns if _is_ensemble(data) else _single_columns
    return [Column("", "label", key="entry"), Column("", "scheme"), *plain, *measured(data)]


def _reversal_label(data: Data) -> str:
    return "reversal defect" + (f" at h = {abs(data['schemes'][0]['h']):g}" if _same_step(data) else "")


def _single_columns(data: Data) -> list[Column]:
    from topcli.engine.precise_numbers import RATIONAL

    schemes, rational = data["schemes"], data["config"].get("precision") == RATIONAL
    spacing = data["reference"]["swing_spacing"]
    swing = f"spacing of {data['reference']['swing']} minima"
    swing += "" if spacing is None else f" (reference {spacing:.4f})"
    closed = ", of a closed form per state" if any(scheme["closed_form"] for scheme in schemes) else ""
    set_up = "set-up, s" if any(scheme["setup_seconds"] is not None for scheme in schemes) else ""

    def order(scheme: Data) -> str | None:
        reversal = scheme["reversal"]
        if reversal["order"] is not None or reversal["defect"] is None:
            return None if reversal["order"] is None else f"{reversal['order']:.2f}"
        return "exact" if rational and reversal["defect"] == 0.0 else "round-off"

    return [
        Column("outcome", "outcome"),
        Column("", "message"),
        Column("max error", "max_error", number),
        Column("error at the end", "end_error", number),
        *_invariant_columns(schemes),
        *_modified_columns(schemes),
        Column(_reversal_label(data), "reversal.defect", number, "reversal_defect"),
        Column("  its order in h", order),
        Column("", "reversal.order", key="reversal_order"),
        Column(swing, "swing_spacing", "{:.4f}".format),
        Column(f"ns per step{closed}", "nanoseconds_per_step", "{:.1f}".format),
        Column("compile or load, s", "compile_seconds", "{:.3f}".format, ""),
        Column(set_up, "setup_seconds", "{:.3f}".format, ""),
    ]


def _invariant_columns(schemes: Sequence[Data]) -> Iterator[Column]:
    """Figures of the report that comparisons show, of each invariant of the top."""
    from topcli.runs.report import REPORT_COLUMNS

    for i, invariant in enumerate(schemes[0]["invariants"]):
        for figure in REPORT_COLUMNS:
            if figure.compared:
                head, key = figure.compared.format(invariant["symbol"]), f"{invariant['name']}_{figure.of}"
                yield Column(head, f"invariants.{i}.{figure.of}", figure.show, key)


def _modified_columns(schemes: Sequence[Data]) -> Iterator[Column]:
    """Figures of the integrals of the schemes themselves; a dash if a scheme has no such integral."""

    def correction(term: Data) -> str:
        power = {1: "h", 2: "h²"}.get(term["power"], f"h^{term['power']}")
        return f"{number(term['size'])} = {term['coefficient']:.3g} {power}"

    for name, known in {row["name"]: row for scheme in schemes for row in scheme["modified"]}.items():

        def of(scheme: Data, key: str, name: str = name) -> Any:
            return next((row[key] for row in scheme["modified"] if row["name"] == name), None)

        yield Column(
            f"{known['symbol']} max deviation", partial(of, key="max_deviation"), number, f"{name}_max_deviation"
        )
        yield from (Column("", partial(of, key=key), key=f"{name}_{key}") for key in ("drift", "drift_error"))
        yield Column("  verdict", partial(of, key="verdict"), key=f"{name}_verdict")
        if "correction" in known:
            yield Column(f"  less {known['correction']['of']}, at most", partial(of, key="correction"), correction)


def _ensemble_columns(data: Data) -> Iterator[Column]:
    """Outcomes, and quantiles of each measure."""
    schemes = data["schemes"]
    yield Column("", "message")
    yield Column("reached the end", "reached_end")
    for outcome in dict.fromkeys(name for scheme in schemes for name in scheme["outcomes"] if name != "completed"):
        yield Column(f"  {outcome.replace('_', ' ')}", lambda row, name=outcome: row["outcomes"].get(name, 0))
    for name, label in _measure_labels(data).items():

        def of(scheme: Data, key: str, name: str = name) -> Any:
            return scheme["measures"][name][key] if name in scheme["measures"] else None

        show = partial(number, digits=6 if name.startswith("swing") else 3)
        for quantile, head in (("median", f"{label}, median"), ("10 %", "  10 %"), ("90 %", "  90 %")):
            yield Column(head, partial(of, key=quantile), show, f"{name}, {quantile}")
        counts = [(of(scheme, "count"), scheme["reached_end"]) for scheme in schemes]
        fewer = any(count is not None and count < reached for count, reached in counts)
        yield Column("  trajectories with a value" if fewer else "", partial(of, key="count"), key=f"{name}, count")
    yield Column("ns per step, all threads", "nanoseconds_per_step", "{:.1f}".format)


def _measure_labels(data: Data) -> dict[str, str]:
    """Labels of all measures by name, in the order of the lines."""
    invariants = {row["name"]: row["symbol"] for scheme in data["schemes"] for row in scheme["invariants"]}
    labels = {"error.max": "max error", "error.end": "error at the end"}
    for name, symbol in invariants.items():
        labels[f"deviation.{name}"] = f"{symbol} max deviation"
        labels[f"drift.{name}"] = f"{symbol} drift per unit time"
    labels |= {"reversal": _reversal_label(data), "swing_spacing.first": f"spacing of {data['swing']} minima"}
    measured = {name for scheme in data["schemes"] for name in scheme["measures"]}
    return {name: label for name, label in labels.items() if name in measured}


def _reference_note(data: Data) -> str:
    reference = data["reference"]
    return f"Errors are norms of the difference of states from the {reference['method']}." if reference else ""


TABLE = Table(
    "schemes",
    _columns,
    heading="Comparison",
    title=_title,
    caption=_reference_note,
    index="entry",
    across=Column("", _label),
)


def _completed(scheme: Data) -> bool:
    """True if an entry completed, or all of its trajectories did."""
    return set(scheme["outcomes"]) == {"completed"} if "outcomes" in scheme else scheme["outcome"] == "completed"


def head(data: Data) -> Head:
    """Head of the chapter."""
    title, _, subtitle = _title(data).partition(": ")
    lines = faults(data).lines
    return Head(title, subtitle, f"{len(lines)} failed" if lines else "completed", not lines, "; ".join(lines))


def notes(data: Data) -> Iterator[str]:
    """Warnings about few rows, and about trajectories without a value."""
    if data.get("few_rows"):
        yield (
            f"warning: the steps share {data['rows']} times, at which the errors are compared; "
            "steps whose ratio is simple, such as 2 or 5, share more"
        )
    for scheme in data["schemes"]:
        for name, fault in scheme.get("faults", {}).items():
            missing = f"no value for {fault['count']} of {data['trajectories']} trajectories"
            first = f"trajectory {fault['trajectory']}: {fault['reason']}"
            yield f"warning: {scheme['label']}: {name}: {missing}; {first}"


def faults(data: Data) -> Faults:
    """Entries that did not complete, and those whose code failed."""
    failed = data.get("failed", [])
    bad = [scheme for scheme in data["schemes"] if not _completed(scheme)]
    lines = [f"{row['label']}: {row['message']}" for row in bad]
    lines += [f"{row['label']}: {row['reason']}" for row in failed]
    partly = any("completed" in scheme.get("outcomes", ()) for scheme in data["schemes"])
    if failed or (bad and partly):
        return Faults(ExitCode.PARTLY_FAILED, lines)
    return Faults(ExitCode.FAILED if bad else ExitCode.SUCCESS, lines)


def _frame_of_series(result: Result) -> Any:
    import pandas as pd

    return pd.DataFrame(dict(result.arrays))


COMPARE = Study(
    "compare",
    measure,
    head,
    (TABLE,),
    notes=notes,
    faults=faults,
    figure="topcli.figures.comparison:loaded_comparison",
    plotted="topcli.figures.comparison:comparison_curves",
    draws="errors and swings over time",
    captions=lambda data: ("error of the state over time t", f"{data['reference']['swing']} over time t"),
    stem=lambda data: str(data["config"]["name"]),
    parts=cited_parts,
    saved=True,
    extras={
        "figures": lambda result: result.data,
        "arrays": lambda result: result.arrays,
        "series": _frame_of_series,
    },
)
