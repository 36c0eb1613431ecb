"""Loading of a config file, a packaged scene or a dict as a validated ``Experiment``."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pydantic import BaseModel

from topcli.config.document import Document, plain
from topcli.config.files import find_config, first_sentence, read_document, scene_files
from topcli.config.models import Config, Experiment, Output, PoincareSection, changed_name, name_fault
from topcli.config.overrides import apply_overrides, drop_partner, parse_override
from topcli.config.ranges import duration_fault, steps_of
from topcli.config.sections import read_columns, read_initial, read_scheme, read_top
from topcli.config.written import read_written, with_written_numbers
from topcli.contracts import Scheme, Top
from topcli.engine.numbers import DOUBLE, MAX_DIGITS, RATIONAL
from topcli.errors import ConfigError, StepTooLongError, TopcliError, quoted
from topcli.schemes.own_tops import forms
from topcli.tops import CUSTOM, TOPS
from topcli.tops.bodies import checked_rotation

if TYPE_CHECKING:
    from topcli.config.ensemble import EnsembleExperiment

Source = Path | str | Mapping[str, Any]
"""A config file (.yaml, .yml, .toml), the name of a packaged scene such as ``kowalevski_hk``, or a config as a dict."""


def load(
    source: Source, overrides: Sequence[str] = (), changes: Mapping[str, Any] | None = None, *, rename: bool = False
) -> Experiment | EnsembleExperiment:
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
    loaded = _experiment(*read_config(source, overrides, changes))
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
    document, name = read_config(source, overrides, changes)
    loaded = _experiment(document, name)
    if not isinstance(loaded, Experiment):
        fault = f"this is an ensemble of {loaded.count} trajectories, but a single trajectory is needed here; "
        commands = "`topcli run` and topcli.simulate take ensembles; `topcli sweep` compares schemes on many states"
        raise ConfigError(document.message(("ensemble",), fault + commands))
    if loaded.precision != DOUBLE and not any_precision:
        commands = "`topcli run`, `topcli compare` and topcli.simulate take another precision"
        raise ConfigError(document.message(("precision",), f"computed in doubles here; {commands}"))
    return loaded if crossings else loaded.of_all_steps()


def read_config(
    source: Source, overrides: Sequence[str] = (), changes: Mapping[str, Any] | None = None
) -> tuple[Document, str | None]:
    """Return the document of a config with changes and overrides, and the default name of its experiment, if any."""
    if isinstance(source, (str, os.PathLike)):
        path = find_config(source)
        document, name = read_document(path), path.stem
    elif isinstance(source, Mapping):
        document, name = Document(plain(source, Document({}))), None
    else:
        raise ConfigError(f"a config is a dict with the keys {', '.join(Config.model_fields)}")
    new = plain(changes or {}, Document({}))
    drop_partner(document.data, new)
    document.data |= new
    document.places = {key: place for key, place in document.places.items() if not key or key[0] not in new}
    document.places |= {(key,): "" for key in new}
    apply_overrides(document, overrides)
    return document, name


def scenes(top: str | None = None) -> Iterator[tuple[str, Experiment, int, str]]:
    """Yield name, first trajectory, number of trajectories and description of each packaged scene.

    ``top`` restricts them to one top. Raises UnknownNameError for an unknown top.
    """
    wanted = [form.form for form in forms(top)] if top else list(TOPS)
    for name, path in scene_files().items():
        scene = load(path)
        first, count = (scene, 1) if isinstance(scene, Experiment) else (scene.first, scene.count)
        if first.top.form in wanted:
            yield name, first, count, first_sentence(path)


OPTIONAL = ("name", "output", "ensemble", "section", "T", "precision", "max_digits")
"""Keys that may be empty."""


def _experiment(document: Document, default_name: str | None) -> Experiment | EnsembleExperiment:
    """Return the experiment or ensemble of a document. Raises as ``load``."""
    if "base" in document.data:
        fault = "this is a sweep, but an experiment is needed here; `topcli sweep` takes sweeps"
        raise ConfigError(document.message(("base",), fault))
    data = {key: value for key, value in document.data.items() if key not in OPTIONAL or value is not None}
    data = with_written_numbers(data)
    if "name" not in data and default_name is not None:
        if fault := name_fault(default_name):
            document.fault(("name",), f"missing, and the file name cannot be used instead: {fault}")
        data["name"] = "unnamed" if fault else default_name
    if "ensemble" in data:
        data.setdefault("initial", {})
    if isinstance(initial := data.get("initial"), dict) and "from" in initial:
        from topcli.config.continued import last_state  # with the store, which other configs spare

        with document.at("initial"):
            data["initial"] = last_state(initial, lambda vectors: _top({**data, "initial": vectors}, document)[1])
        document.check()

    # the sections, each by itself
    config = _config(data, document)
    cls, top = _top(data, document)
    if cls and cls.form in TOPS.declared and (default_name or cls.form not in TOPS.names):  # a study derives configs
        TOPS.names[cls.form] = str(data.get("name", CUSTOM))
    scheme = read_scheme(data["scheme"], cls, document) if cls and "scheme" in data else None
    state = members = None
    if cls and top and "ensemble" in data:
        from topcli.config.ensemble import read_members

        parameters = cls.parameters_in(data["top"])
        members = read_members(data["ensemble"], data["initial"], cls, top, parameters, document)
        state = members.groups[0].state(0) if members else None
    elif cls and "initial" in data and "ensemble" not in data:
        state = read_initial(data["initial"], cls, document)
    document.check()
    assert config is not None  # what is missing has been refused
    assert config.N is not None
    assert top is not None
    assert scheme is not None
    assert state is not None

    # the keys that depend on each other
    section, output = _recorded(config, top, scheme, document)
    _check(config, config.N, top, document)
    document.check()
    written = read_written(data, top, state, config.precision, document) if config.precision != DOUBLE else None
    document.check()
    experiment = Experiment(
        name=config.name or f"{top.kind}_{scheme[0].name}".replace("-", "_"),
        top=top,
        y0=state,
        scheme=scheme[0],
        options=scheme[1],
        h=config.h,
        N=config.N,
        output=output,
        section=section,
        precision=config.precision,
        max_digits=config.max_digits or MAX_DIGITS,
        written=written,
    )
    if members is None:
        _require_short_step(experiment, document)
        return experiment
    from topcli.config.ensemble import EnsembleExperiment

    first = experiment.model_copy(update={"top": members.groups[0].top})
    return EnsembleExperiment(first, members, experiment.top)


def _recorded(
    config: Config, top: Top, scheme: tuple[Scheme, BaseModel], document: Document
) -> tuple[PoincareSection | None, Output]:
    """Return the section and the output with the texts of their formulas and the names of the columns."""
    output, section = config.output, config.section
    if output.quantities or output.columns or section:
        from topcli.config.formulas import read_quantities, read_section

        integrals = top.invariants() + (scheme[0].modified(top, config.h, scheme[1]) if scheme[0].modified else ())
        columns = read_columns(output, top.components, integrals, document)
        quantities = read_quantities(output, type(top), integrals, document)
        output = output.model_copy(update={"columns": columns, "quantities": quantities})
        section = section and read_section(section, type(top), document)
    return section, output


def _require_short_step(experiment: Experiment, document: Document) -> None:
    """Raise StepTooLongError if the scheme cannot take the step h from the initial state."""
    scheme, h = experiment.scheme, experiment.h
    if not scheme.longest_step:
        return
    longest = scheme.longest_step(experiment.top, experiment.y0, experiment.options)
    if abs(h) <= longest:
        return
    text = f"no step is possible under {scheme.name} from this state"
    if longest > 0.0:
        digit = 10.0 ** (math.floor(math.log10(longest)) - 3)
        most = math.floor(longest / digit) * digit  # rounded down, so that it is admissible
        text = f"|h| must be at most {most:.4g} under {scheme.name} from this state, not {abs(h):g}"
    raise StepTooLongError(document.message(("h",), text))


def _config(data: dict[str, Any], document: Document) -> Config | None:
    """Return the keys of the top level, with N from T; None if one is wrong."""
    config = document.read(Config, data)
    if "T" in data and "N" in data:
        where = document.place(("N",))
        document.fault(("T",), f"N is given too{f' ({where})' if where else ''}; keep one of them")
    elif "T" not in data and data.get("N") is None:
        document.fault(("N",), f"missing; give {Config.model_fields['N'].description}")
    elif config and config.T:
        with document.at("T"):
            return config.model_copy(update={"N": steps_of(config.T, config.h), "T": None})
    return config


def _check(config: Config, N: int, top: Top, document: Document) -> None:
    """Add the faults of keys that exclude each other or depend on N."""
    output, section, many = config.output, config.section, config.ensemble
    attitude, other = output.attitude, config.precision != DOUBLE
    store = many.get("store") if isinstance(many, dict) else None
    for key, wrong, text in (
        ("output.every", output.every > N, f"must be at most N = {N}, not {output.every}"),
        ("N", duration_fault(config.h, N), duration_fault(config.h, N)),
        ("precision", other and many, "an ensemble runs in doubles only; run single trajectories in another precision"),
        ("max_digits", config.max_digits and config.precision != RATIONAL, "needs precision: rational"),
        ("output.attitude", attitude and many, "an ensemble records no attitude; run single trajectories with it"),
        ("output.attitude", attitude and other, "the attitude is computed in doubles only; leave out precision or it"),
        ("section", section and attitude, "a section records no attitude; leave out output.attitude"),
        ("section", section and other, "crossings are located in doubles only; leave out precision"),
        ("output.every", section and output.every > 1, "a section looks at every step; leave out output.every"),
        (
            "ensemble.store",
            section and store not in (None, "trajectories"),
            "a section records every crossing; leave out store",
        ),
    ):
        if wrong:
            document.fault(tuple(key.split(".")), text)
    if attitude and not document.faults:
        with document.at("output", "attitude"):
            checked_rotation(top, "the attitude")
        if taken := [name for name in output.attitude_columns if name in top.components]:
            text = f"the top has a component {quoted(taken[0])} of its own; use another form"
            document.fault(("output", "attitude"), text)


def _top(data: dict[str, Any], document: Document) -> tuple[type[Top] | None, Top | None]:
    """Return the class of the top and the top; None for each that is missing or cannot be read."""
    if "top" not in data:
        return None, None
    named = data.get("initial")
    if "ensemble" in data and isinstance(named, dict):
        from topcli.config.ensemble import vectors_named

        named = dict.fromkeys(vectors_named(data["ensemble"])) | named
    return read_top(data["top"], named, document)
