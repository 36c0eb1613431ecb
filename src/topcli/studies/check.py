"""``topcli check``: compare the declared properties of schemes and tops with measurements."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from topcli.config.files import is_config
from topcli.config.load import load_experiment
from topcli.config.models import Experiment
from topcli.errors import ExitCode, UsageError, counted, quoted
from topcli.plugins import load_plugin_file
from topcli.schemes.registry import all_schemes
from topcli.studies import SILENT, Watch
from topcli.studies.entries import code_failures, schemes_called
from topcli.studies.report import Report, Table
from topcli.table import two_digits
from topcli.testing import Trait, check_scheme, check_top
from topcli.tops import TOPS, forms, top_names, top_origin


def check(
    file: str | Path | None = None,
    *,
    scheme: Sequence[str] = (),
    top: str | None = None,
    config: str | Path | Mapping[str, Any] | None = None,
    overrides: Sequence[str] = (),
    watch: Watch = SILENT,
) -> Report:
    """Check the declared properties of schemes and tops.

    For a scheme, the study checks order, self-adjointness, and exact and modified invariants. It also checks that
    compiled code agrees with plain Python, and that ensembles agree with single runs. For a top, it checks the
    equations and the integrals. The command exits with code 4 if a scheme or top is not as declared.
    ``topcli.testing`` has the same checks for tests of your own.

    Parameters
    ----------
    file : path or str, optional
        Python file with the tops and schemes to check.
    scheme : sequence of str, optional
        Name of a scheme to check; by default, the schemes of the file are checked.
    top : str, optional
        Name of the top to check, and for which the schemes are checked.
    config : path, str or mapping, optional
        Config with the parameters of the top and the initial state of the checks; by default, a generic state.
    overrides : sequence of str, optional
        Override a key of the config, e.g. top.c0=-1.
    watch : Watch, optional
        Observer of the study.

    Returns
    -------
    Report
        ``table`` has a row for each declared trait, with the measured deviation, the largest allowed one, and the
        verdict.

    Raises
    ------
    UsageError
        If a scheme or top is unknown, or if a file cannot be loaded.

    Examples
    --------
    >>> import topcli
    >>> report = topcli.check(scheme=["hk"], top="euler")
    >>> set(report.table["verdict"])
    {'holds'}
    """
    experiment = None if config is None else load_experiment(config, overrides)
    subjects = _subjects(file, scheme, top, experiment)
    watch.begin("check", unit="parts")
    rows: list[dict[str, Any]] = []
    broken: list[str] = []
    for done, (label, (form, name)) in enumerate(subjects.items(), start=1):
        configured = experiment if experiment and experiment.top.form == form else None
        subject, y0 = (configured.top, configured.y0) if configured else (form, None)
        options = configured.options if configured and configured.scheme.name == name else None
        with code_failures(broken, label):
            traits = check_scheme(name, subject, options, y0) if name else check_top(subject, y0)
            rows += [_row(label, trait) for trait in traits]
        watch(done, len(subjects))
    said = {verdict: [row for row in rows if row["verdict"] == verdict] for verdict in ("holds", "false", "undecided")}
    false = [f"{row['of']}: {row['trait']}: {row['why'] or two_digits(row['measured'])}" for row in said["false"]]
    undecided = [f"{row['of']}: {row['trait']}: {row['why']}" for row in said["undecided"]]
    code = ExitCode.VIOLATED if false else ExitCode.WRONG_USAGE if broken else ExitCode.SUCCESS
    wrong = f"{counted(len(false), 'declaration')} false" if false else "no declaration is false"
    answer = f"{wrong}; {len(said['holds'])} hold" + (f", {len(undecided)} undecided" if undecided else "")
    tables = [Table("Declarations", rows, {"measured": two_digits, "allowed": two_digits}, detail=("why",))]
    return Report("check", ", ".join(subjects), answer, tables, undecided, [*broken, *false], code)


def _row(subject: str, trait: Trait) -> dict[str, Any]:
    verdict = "undecided" if math.isnan(trait.measured) else "holds" if trait.holds else "false"
    measured = None if math.isnan(trait.measured) else float(trait.measured)
    figures = {"measured": measured, "allowed": trait.allowed, "verdict": verdict, "why": trait.why or None}
    return {"of": subject, "trait": trait.trait, **figures}


def _subjects(
    file: str | Path | None, names: Sequence[str], top: str | None, experiment: Experiment | None
) -> dict[str, tuple[str, str]]:
    """Form of a top and name of a scheme, empty for the top itself, by label: those of a file, of a top, or named.

    Raises UsageError if that is nothing, and for unknown names.
    """
    origin = None if file is None else str(Path(file))
    if file is not None:
        if Path(file).suffix != ".py" and is_config(str(file)):
            hint = f"to check its top: topcli check --config {file}"
            raise UsageError(f"{quoted(str(file))} is a config, not a Python file; {hint}")
        for kind, registered in (("scheme", {each.name for each in all_schemes()}), ("top", {*top_names()})):
            if str(file) in registered and not Path(file).exists():
                raise UsageError(f"{quoted(str(file))} is a {kind}, not a Python file; give --{kind} {file}")
        load_plugin_file(Path(file))
    tops = [form for form in TOPS if top_origin(TOPS[form]) == origin]
    if top or experiment:
        tops = [form.form for form in forms(top)] if top else [experiment.top.form] if experiment else []
    schemes = [(each.top, each.name) for each in all_schemes() if each.origin == origin]
    if top or experiment:
        schemes = [(form, name) for form, name in schemes if form in tops]
    if names:
        schemes = [(each.top, each.name) for name in names for each in schemes_called(name, tops)]
        tops = tops if top or experiment or file else []
    if not (tops or schemes):
        what = f"plugin {file}: registers no top and no scheme" if file else "nothing to check"
        raise UsageError(f"{what}; give a file, --scheme or --top")
    subjects = {TOPS.called(form): (form, "") for form in tops}
    return subjects | {f"{name} ({TOPS.called(form)})": (form, name) for form, name in schemes}
