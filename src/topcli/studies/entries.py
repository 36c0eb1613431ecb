"""Entries of a comparison: schemes with their own options and step size, such as ``hybrid:branch=sign,h=0.01``.

All entries cover the same time. Entries with different steps are compared at times that all of them reach exactly.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from topcli.config.load import load_experiment
from topcli.config.models import Experiment
from topcli.contracts import Scheme
from topcli.errors import SchemeCodeError, UsageError, counted, printable, quoted, shortened
from topcli.plugins import users_error
from topcli.schemes.registry import find_scheme, names_for
from topcli.testing import GENERIC
from topcli.tops import TOPS, forms

SCENE = "kowalevski_generic_hk"
"""Packaged scene that a study takes without a config."""
FEW_ROWS = 100
"""Smallest number of times that entries share, if the config asks for them and each has as many steps."""


def common_strides(base: Experiment, experiments: Sequence[Experiment]) -> list[int]:
    """Steps of each experiment between rows at common times, at most as many rows as ``base`` has.

    Raises UsageError if the experiments share few times.
    """
    if all(experiment.N == base.N for experiment in experiments):
        return [base.output.every] * len(experiments)
    rows, steps = max(1, base.N // base.output.every), [experiment.N for experiment in experiments]
    shared = math.gcd(*steps)
    count = max(divisor for divisor in range(1, min(rows, shared) + 1) if shared % divisor == 0)
    if count < min(FEW_ROWS, rows, *steps):
        raise UsageError(
            f"the step sizes share only {counted(count, 'time')} after the start; "
            "step sizes with a simple ratio, such as 2 or 5, share more"
        )
    return [experiment.N // count for experiment in experiments]


def entries_of(
    base: Experiment,
    texts: Sequence[str],
    default: Sequence[str] = (),
    obstacle: Callable[[Experiment], str] = lambda experiment: "",
) -> dict[str, Experiment]:
    """Experiments of all entries by label; without ``texts`` those of the ``default`` that fit the top.

    ``obstacle`` is the reason why a study cannot use an entry, empty if it can. Raises UsageError for such an entry,
    for a wrong text, and for two entries that compute the same.
    """
    if not (texts or default):
        raise UsageError("name at least one scheme, as in: hk hybrid:branch=sign")
    labels: dict[str, str] = {}
    experiments: dict[str, Experiment] = {}
    for text in texts or default:
        label = printable(text.replace(" ", "").lower())
        try:
            experiment = entry_named(base, text)
            same = f"{experiment.scheme.name} {experiment.options.model_dump_json()} {experiment.h}"
            if (earlier := labels.get(same)) is not None:
                what = "is named twice" if earlier == label else f"computes the same as {earlier}; keep one of them"
                raise UsageError(f"{label}: {what}")
            if reason := obstacle(experiment):
                raise UsageError(f"{label}: {reason}")
        except UsageError as error:
            if texts or isinstance(error, SchemeCodeError):
                raise
            continue
        labels[same], experiments[label] = label, experiment
    return experiments


SCHEME = {"scheme": "name schemes and their options as arguments, such as hybrid:branch=sign"}
"""Key that no override of a study of named schemes may set, and the reason."""


def refuse_keys(overrides: Sequence[str], reasons: Mapping[str, str]) -> None:
    """Raise UsageError for an override of a key, or of a part of it, for which there is a reason not to set it."""
    for text in overrides:
        key = text.partition("=")[0].strip().partition(".")[0]
        if key in reasons:
            raise UsageError(f"--set {shortened(text)}: {reasons[key]}")


OWN = ("h", "N", "T")
"""Keys of an entry that are no options of its scheme."""


def entry_named(base: Experiment, text: str) -> Experiment:
    """``base`` under the scheme of ``text``, such as ``hybrid:branch=sign,h=0.01``, over the same time.

    Raises UsageError; the message on a setting begins with the text.
    """
    name, _, settings = text.partition(":")
    sets = [part.strip() for part in settings.split(",") if part]
    find_scheme(name, base.top.form)
    config = base.resolved()
    same = config["scheme"]["name"].partition("+")[0] == name.lower().partition("+")[0]
    config["scheme"] = {**(config["scheme"] if same else {}), "name": name}
    if any(part.partition("=")[0].strip() == "h" for part in sets):
        config.pop("N", None)
        config["output"] = {**config["output"], "every": 1}  # that of the base may be longer than the new run
        sets.append(f"T={base.duration!r}")
    overrides = [part if part.partition("=")[0].strip() in OWN else f"scheme.{part}" for part in sets]
    try:
        return load_experiment(config, overrides, any_precision=True)
    except UsageError as error:
        raise type(error)(f"{shortened(text)}: {error.lines[0]}", *error.lines[1:]) from None


def experiment_on(
    top: str, scheme: str, config: str | Path | Mapping[str, Any] | None, overrides: Sequence[str], h: float, N: int
) -> Experiment:
    """Experiment of ``config`` with the ``scheme``, or without a config of a top from a state in general position.

    Raises UsageError for a config of another top than that called ``top``.
    """
    if config is not None:
        experiment = load_experiment(config, overrides, {"scheme": scheme} if scheme else {})
        if top.lower() not in (experiment.top.kind, experiment.top.form):
            forms(top)
            of = quoted(experiment.top.kind)
            raise UsageError(f"{shortened(str(config))} is of the top {of}, not {quoted(top)}")
        return experiment
    bodies, scheme = forms(top), scheme or "hk"
    base = scheme.lower().partition(":")[0].partition("+")[0]
    body = next((form for form in bodies if base in names_for(form.form)), bodies[0]).new()
    state = [GENERIC[i % len(GENERIC)] for i in range(len(body.components))]
    initial = {**body.initial_section(state), **({"normalize": True} if body.unit_vectors else {})}
    return load_experiment({"top": body.section(), "initial": initial, "scheme": scheme, "h": h, "N": N}, overrides)


def schemes_called(name: str, fits: Sequence[str] = ()) -> list[Scheme]:
    """Schemes called ``name``, one for each form of a top that it steps, among the forms ``fits``; by default all.

    Raises UnknownNameError for an unknown name, and SchemeMisfitError for a scheme of other tops.
    """
    fits, base = fits or list(TOPS), name.lower().partition("+")[0]
    return [find_scheme(name, form) for form in [form for form in fits if base in names_for(form)] or fits[:1]]


@contextmanager
def code_failures(failures: list[str], label: str) -> Iterator[None]:
    """Append to ``failures`` if the code of a scheme or top, from a user's file or a plugin, fails within."""
    try:
        yield
    except Exception as error:
        cause = error if isinstance(error, SchemeCodeError) else users_error(error)
        if cause is None:
            raise
        failures.append(f"{label}: {cause}")
