"""Loading of a config file, a packaged scene or a dict as a validated ``Experiment``."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from itertools import combinations
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from topcli.config.document import BARE, Document, describe, parse_override
from topcli.config.ensemble import read_ensemble
from topcli.config.files import find_config, first_sentence, read_document, scene_files
from topcli.config.models import Config, Experiment, changed_name, steps_of
from topcli.config.states import read_states, vectors_in, vectors_named
from topcli.config.text import KeyPath
from topcli.config.written import read_written, with_written_numbers
from topcli.contracts import Array, Outcome, Scheme, Top
from topcli.engine.numbers import DOUBLE, MAX_DIGITS, RATIONAL
from topcli.errors import ConfigError, StepTooLongError, TopcliError, UsageError
from topcli.schemes.registry import find_scheme, names_for
from topcli.tops import CUSTOM, TOPS, forms, top_class, top_names
from topcli.tops.bodies import checked_rotation

Source = Path | str | Mapping[str, Any]
"""A config file (.yaml, .yml, .toml), the name of a packaged scene such as ``kowalevski_hk``, or a config as a dict."""

Start = Callable[[Top, Any], Array]
"""Reader of initial states (m, d) from a top and the section ``initial``."""

RESULTS = Path("results")
"""Folder in which a run is found by its name."""


def load(
    source: Source, overrides: Sequence[str] = (), changes: Mapping[str, Any] | None = None, *, rename: bool = False
) -> Experiment:
    """Load an experiment or ensemble from a config.

    ``changes`` replace whole top-level keys of the config. ``overrides`` are texts ``key=value``; they are applied
    after the changes and before the config is validated. If the config is a dict, its lists may also be tuples or numpy
    arrays.

    The default name of the experiment is the name of the file or scene; for a dict, it is made from top and scheme.
    With ``rename``, the first digits of the digest (a hash of the experiment) are appended to the name if changes or
    overrides alter the computed or recorded data of a file or scene, as in ``kowalevski_hybrid-3f2a9c``. A name that a
    change or override sets is kept, and so is the name of a dict.

    Raises ConfigError or UnknownNameError. The message gives ``file:line``, the key, what is wrong and what is right.
    """
    loaded, _ = _loaded(source, overrides, changes)
    named = "name" in (changes or {}) or any(parse_override(text)[0] == ("name",) for text in overrides)
    if not rename or named or isinstance(source, Mapping) or not (overrides or changes):
        return loaded
    try:
        base = load(source).digest
    except TopcliError:  # the changes complete or correct it
        base = ""
    return loaded if loaded.digest == base else loaded.renamed(changed_name(loaded.name, loaded.digest))


def load_experiment(
    source: Source,
    overrides: Sequence[str] = (),
    changes: Mapping[str, Any] | None = None,
    *,
    any_precision: bool = False,
    crossings: bool = False,
) -> Experiment:
    """Load a single experiment from a config; an ensemble is refused.

    A config with a precision other than double is refused too, unless ``any_precision`` is true. Unless ``crossings``
    is true, a Poincaré section in the config is ignored, so that every step is recorded. Raises the same errors as
    ``load``.
    """
    loaded, document = _loaded(source, overrides, changes)
    if loaded.ensemble:
        fault = f"this is an ensemble of {loaded.ensemble.count} trajectories, but a single trajectory is needed here; "
        commands = "`topcli run` and topcli.simulate take ensembles; `topcli sweep` compares schemes on many states"
        document.fault(("ensemble",), fault + commands)
    if loaded.precision != DOUBLE and not any_precision:
        commands = "`topcli run`, `topcli compare` and topcli.simulate take another precision"
        document.fault(("precision",), f"computed in doubles here; {commands}")
    return loaded if crossings or not loaded.crossings else loaded.model_copy(update={"crossings": None})


def _loaded(source: Source, overrides: Sequence[str], changes: Mapping[str, Any] | None) -> tuple[Experiment, Document]:
    """Return the experiment of a config, and its document. Raises StepTooLongError if its scheme cannot take its h."""
    document, name = read_config(source, overrides, changes)
    experiment, longest = read_experiment(document, name), math.inf
    scheme, h = experiment.scheme, experiment.h
    if scheme.longest_step and not experiment.ensemble:
        longest = scheme.longest_step(experiment.top, experiment.y0, experiment.options)
    if abs(h) > longest:
        most = f"{longest * (1.0 - 1e-4):.5g}"  # rounded down, so that it is admissible
        limit = f"|h| must be at most {most}" if longest else "no step is possible"
        text = f"{limit} under {scheme.name} from this state, not {abs(h):g}"
        raise StepTooLongError(document.message(("h",), text))
    return experiment, document


def read_config(
    source: Source, overrides: Sequence[str] = (), changes: Mapping[str, Any] | None = None
) -> tuple[Document, str | None]:
    """Return the document of a config with changes and overrides, and the default name of its experiment, if any."""
    if isinstance(source, (str, os.PathLike)):
        path = find_config(source)
        document, name = read_document(path), path.stem
    elif isinstance(source, Mapping):
        document, name = Document.of(source), None
    else:
        raise ConfigError(f"a config is a dict with the keys {', '.join(Config.model_fields)}")
    document.drop_partner(changes or {})
    for key, value in (changes or {}).items():
        document.set((key,), value)
    document.override(overrides)
    return document, name


def packaged_scenes(top: str | None = None) -> Iterator[tuple[str, Experiment, int, str]]:
    """Yield name, first trajectory, number of trajectories and description of each packaged scene.

    ``top`` restricts them to one top. Raises UnknownNameError for an unknown top.
    """
    included = [form.form for form in forms(top)] if top else list(TOPS)
    for name, path in scene_files().items():
        scene = load(path)
        if scene.top.form in included:
            yield name, scene, scene.ensemble.count if scene.ensemble else 1, first_sentence(path)


def read_experiment(
    document: Document, default_name: str | None, start: Start | None = None, named: Iterable[str] = ()
) -> Experiment:
    """Return the experiment or ensemble of a document. Raises as ``load``.

    ``start(top, initial)`` reads the states (m, d) of rows of a sweep, which also name the vectors or components
    ``named``.
    """
    if "base" in document.data:
        document.fault(("base",), "this is a sweep, but an experiment is needed here; `topcli sweep` takes sweeps")
    data = {key: value for key, value in document.data.items() if value is not None or key not in Config.model_fields}
    if data.get("precision", DOUBLE) != DOUBLE:
        data |= {key: with_written_numbers(data[key]) for key in ("h", "top", "initial") if key in data}
    if "name" not in data and default_name is not None:
        data["name"] = default_name
    initial: Any = data.get("initial", {})
    if isinstance(initial, dict) and "from" in initial:
        with document.at("initial"):
            initial = last_state(initial, lambda vectors: read_top(data.get("top"), vectors, document))

    # the sections, each by itself; vectors and components choose the form of the top
    config = document.read(Config, data)
    N = _steps(config, document)
    vectors = [*(initial if isinstance(initial, dict) else ()), *named]
    vectors += config.ensemble.named if config.ensemble else []
    top = read_top(data["top"], vectors, document)
    scheme, options = read_scheme(data["scheme"], type(top), document)
    many = None
    if config.ensemble:
        with_parameters = partial(_top_with, type(top), top.parameters_in(data["top"]), document)
        many = read_ensemble(config.ensemble, initial, top, with_parameters, document)
    states = many.states if many else start(top, initial) if start else read_states(type(top), initial, document)
    experiment = Experiment(
        name=config.name or f"{top.kind}_{scheme.name}".replace("-", "_"),
        top=top,
        y0=tuple(states[0].tolist()),
        ensemble=many,
        scheme=scheme,
        options=options,
        h=config.h,
        N=N,
        output=config.output,
        crossings=config.section,
        precision=config.precision,
        max_digits=config.max_digits or MAX_DIGITS,
    )

    # the keys that depend on each other
    changes: dict[str, Any] = {}
    if config.output.quantities or config.output.columns or config.section:
        from topcli.config.formulas import read_columns  # whose parser other configs do not need

        changes |= read_columns(experiment, document)
    _check(experiment, config, document)
    if config.precision != DOUBLE:
        sections = data | {"initial": vectors_in(type(top), initial)}
        changes["written"] = read_written(sections, top, experiment.y0, config.precision, document)
    return experiment.model_copy(update=changes) if changes else experiment


def read_top(raw: object, names: Iterable[str], document: Document) -> Top:
    """Return the top with its parameters. The vectors and components in ``names`` choose among the forms of a top."""
    kind, where, section = _named_section(raw, "top", top_names, document)
    if kind.lower() == CUSTOM:
        from topcli.config.formulas import read_custom  # whose models other configs do not need

        cls = read_custom(section, document)
        section = cls.parameters_in(section)
    else:
        with document.at(*where):
            cls = top_class(kind, vectors_named(kind, names))
    return _top_with(cls, section, document, {}, ("top",))


def _top_with(
    cls: type[Top], parameters: Mapping[str, Any], document: Document, changes: Mapping[str, Any], path: KeyPath
) -> Top:
    """Return the top of class ``cls`` with these ``parameters`` and ``changes`` of them, whose place is ``path``."""
    top = document.read(cls, {**parameters, **changes}, *path, beside=("kind",))
    if cls.kind == CUSTOM:
        from topcli.config.formulas import check_numbers

        check_numbers(top, document)
    return top


def read_scheme(raw: object, cls: type[Top], document: Document) -> tuple[Scheme, BaseModel]:
    """Return the scheme for tops of class ``cls``, composed if ``compose`` is given, and its options."""
    name, where, section = _named_section(raw, "scheme", lambda: names_for(cls.form), document)
    with document.at(*where):
        scheme = find_scheme(name, cls.form)
    if "compose" in section:
        with document.at("scheme", "compose"):
            scheme = find_scheme(f"{scheme.name}+{section['compose']}", cls.form)
    return scheme, document.read(scheme.options, section, "scheme", beside=("name", "compose"))


def _named_section(
    raw: object, section: str, names: Callable[[], list[str]], document: Document
) -> tuple[str, KeyPath, dict[str, Any]]:
    """Return the name in a section, its path and the whole section, of which a bare name stands for the first key.

    ``names`` lists the possible names and is called only for a message.
    """
    key = BARE[section]
    name = raw.get(key) if isinstance(raw, dict) else raw
    if isinstance(name, str) and name:
        return (name, (section, key), raw) if isinstance(raw, dict) else (name, (section,), {key: name})
    document.fault((section,), f"must be a name, or a section with {key!r}; known: {', '.join(names())}")


def last_state(initial: Mapping[str, Any], top_of: Callable[[Any], Top]) -> dict[str, Any]:
    """Section ``initial`` with the last state of the stored run that the given section names by ``from``.

    ``top_of(section)`` is the top of the config with this section; it must be that of the run. Raises UsageError.
    """
    from topcli.store.results import read_result  # with the store, which other configs spare
    from topcli.store.series import read_series, series_names

    name = initial["from"]
    if others := [key for key in initial if key not in ("from", "normalize")]:
        raise UsageError(f"from gives the whole state; leave out {', '.join(others)}")
    run = (read_result(Path(name)) or read_result(RESULTS / name)) if isinstance(name, str) and name else None
    if run is None or run.outcome is None:
        raise UsageError(f"from: {describe(name)} is no finished run; give its name in {RESULTS}, or its folder")
    if "ensemble" in run.manifest["config"]:
        raise UsageError(f"from: the run {run.folder} is an ensemble")

    # the last row must be the state in doubles after the last step, of the same top
    manifest, config = run.manifest, run.manifest["config"]
    top, step, every = top_of(config["initial"]), manifest["step"], config["output"]["every"]
    missing = [component for component in top.components if component not in series_names(run.series)]
    reasons = {
        "recorded crossings": "section" in config,
        "is in another precision, and its states are stored in doubles": "precision" in config,
        f"failed: it {manifest['message']}": run.outcome not in (Outcome.COMPLETED, Outcome.INTERRUPTED),
        f"did not record its last state, for {step} steps are no multiple of output.every = {every}": step % every > 0,
        f"did not record {', '.join(missing)}": bool(missing),
        "has another top": config["top"] != top.section(),
    }
    fault = next((reason for reason, wrong in reasons.items() if wrong), "")
    if not fault and (damage := run.damage()):
        fault = f"is damaged: {', '.join(damage)}"
    if fault:
        raise UsageError(f"from: the run {run.folder} {fault}")
    rows = read_series(run.series, top.components)
    state = top.initial_section([float(rows[component][-1]) for component in top.components])
    return {key: value for key, value in initial.items() if key != "from"} | state


def _steps(config: Config, document: Document) -> int:
    """Return the number of steps that N or T gives."""
    if (config.T is None) == (config.N is None):
        document.fault(("N",), "give either the number of steps N or the duration T")
    if config.N is not None:
        return config.N
    assert config.T is not None
    with document.at("T"):
        return steps_of(config.T, config.h)


def _check(experiment: Experiment, config: Config, document: Document) -> None:
    """Refuse keys that exclude each other, and those that do not fit N."""
    output, section, N, h = experiment.output, config.section, experiment.N, experiment.h
    # features that the loop of a run has only one at a time
    features = {
        "ensemble": config.ensemble,
        "section": section,
        "precision": config.precision != DOUBLE,
        "output.attitude": output.attitude,
    }
    for first, second in combinations([key for key, value in features.items() if value], 2):
        if (first, second) != ("ensemble", "section"):
            document.fault(tuple(second.split(".")), f"cannot be combined with {first}; leave out one of them")
    # values that are possible by themselves, but not for this run
    part = section and config.ensemble and config.ensemble.store != "trajectories"
    for key, wrong, text in (
        ("output.every", output.every > N, f"must be at most N = {N}, not {output.every}"),
        ("output.every", section and output.every > 1, "a section looks at every step; leave out output.every"),
        ("N", not math.isfinite(N * h), f"N*h = {N} * {h!r} is not finite; take fewer or smaller steps"),
        ("max_digits", config.max_digits and config.precision != RATIONAL, "needs precision: rational"),
        ("ensemble.store", part, "a section records every crossing; leave out store"),
    ):
        if wrong:
            document.fault(tuple(key.split(".")), text)
    # the attitude needs a rotation of the body, and columns that are free
    if output.attitude:
        with document.at("output", "attitude"):
            checked_rotation(experiment.top, "the attitude")
        if taken := {*output.attitude_columns} & {*experiment.top.components}:
            text = f"the top has a component {min(taken)!r} of its own; use another form"
            document.fault(("output", "attitude"), text)
