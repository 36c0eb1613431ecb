"""Loading of a config file, a packaged scene or a dict as a validated ``Experiment``."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from itertools import combinations
from pathlib import Path
from typing import Any

from topcli.config.document import Document, apply_overrides, drop_partner, parse_override, plain_data, set_key
from topcli.config.ensemble import read_ensemble
from topcli.config.files import find_config, first_sentence, read_document, scene_files
from topcli.config.models import Config, Experiment, changed_name, steps_of
from topcli.config.sections import read_scheme, read_top
from topcli.config.states import read_states, vectors_in
from topcli.config.written import read_written, with_written_numbers
from topcli.contracts import Array, Top
from topcli.engine.numbers import DOUBLE, MAX_DIGITS, RATIONAL
from topcli.errors import ConfigError, StepTooLongError, TopcliError
from topcli.tops import TOPS, forms
from topcli.tops.bodies import checked_rotation

Source = Path | str | Mapping[str, Any]
"""A config file (.yaml, .yml, .toml), the name of a packaged scene such as ``kowalevski_hk``, or a config as a dict."""

Start = Callable[[Top, Any], Array]
"""Reader of initial states (m, d) from a top and the section ``initial``."""


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
    return loaded if crossings or not loaded.section else loaded.model_copy(update={"section": None})


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
        document, name = Document(plain_data(source, Document({}))), None
    else:
        raise ConfigError(f"a config is a dict with the keys {', '.join(Config.model_fields)}")
    drop_partner(document.data, changes or {})
    for key, value in (changes or {}).items():
        set_key(document, (key,), value, "")
    apply_overrides(document, overrides)
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
        from topcli.config.continued import last_state  # with the store, which other configs spare

        with document.at("initial"):
            initial = last_state(initial, lambda vectors: read_top(data.get("top"), vectors, document))

    # the sections, each by itself; vectors and components choose the form of the top
    config = document.read(Config, data)
    N = _steps(config, document)
    vectors = [*(initial if isinstance(initial, dict) else ()), *named]
    top = read_top(data["top"], [*vectors, *(config.ensemble.named if config.ensemble else ())], document)
    scheme, options = read_scheme(data["scheme"], type(top), document)
    many = None
    if config.ensemble:
        many = read_ensemble(config.ensemble, initial, top, top.parameters_in(data["top"]), document)
    states = many.states if many else start(top, initial) if start else read_states(type(top), initial, document)
    state: tuple[float, ...] = tuple(states[0].tolist())
    shared = {key: getattr(config, key) for key in ("h", "output", "section", "precision")}
    experiment = Experiment(
        name=config.name or f"{top.kind}_{scheme.name}".replace("-", "_"),
        top=top,
        y0=state,
        ensemble=many,
        scheme=scheme,
        options=options,
        N=N,
        max_digits=config.max_digits or MAX_DIGITS,
        **shared,
    )

    # the keys that depend on each other
    changes: dict[str, Any] = {}
    output, section = experiment.output, experiment.section
    if output.quantities or output.columns or section:
        from topcli.config.formulas import read_output, read_section  # whose parser other configs do not need

        changes["output"] = read_output(output, type(top), top.invariants() + experiment.modified, document)
        changes["section"] = section and read_section(section, type(top), document)
    _check(experiment, config, document)
    if config.precision != DOUBLE:
        sections = data | {"initial": vectors_in(type(top), initial)}
        changes["written"] = read_written(sections, top, state, config.precision, document)
    return experiment.model_copy(update=changes) if changes else experiment


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
    output, section, N, h = experiment.output, experiment.section, experiment.N, experiment.h
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
    for key, wrong, text in (
        ("output.every", output.every > N, f"must be at most N = {N}, not {output.every}"),
        ("output.every", section and output.every > 1, "a section looks at every step; leave out output.every"),
        ("N", not math.isfinite(N * h), f"N*h = {N} * {h!r} is not finite; take fewer or smaller steps"),
        ("max_digits", config.max_digits and config.precision != RATIONAL, "needs precision: rational"),
        (
            "ensemble.store",
            section and config.ensemble and config.ensemble.store != "trajectories",
            "a section records every crossing; leave out store",
        ),
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
