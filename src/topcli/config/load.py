"""From a config file, a packaged scene or a dict to a validated ``Experiment``."""

from __future__ import annotations

import difflib
import itertools
import math
import os
import stat
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from topcli.config.document import Document, KeyPath, describe, plain
from topcli.config.duration import drop_partner, steps_of
from topcli.config.exact import read_exact, with_written_numbers
from topcli.config.models import (
    Config,
    Experiment,
    changed_name,
    duration_fault,
    name_fault,
    read_columns,
    read_initial,
    read_scheme,
    read_top,
)
from topcli.config.overrides import apply_overrides, override_label, parse_override
from topcli.config.problems import Problems, validate
from topcli.config.yaml_text import parse_yaml
from topcli.contracts import checked_equations
from topcli.engine.precise.numbers import DOUBLE, MAX_DIGITS, RATIONAL
from topcli.errors import (
    ConfigError,
    StepTooLongError,
    TopcliError,
    UnknownNameError,
    UsageError,
    nearest,
    quoted,
    shortened,
)
from topcli.tops import TOPS, forms

if TYPE_CHECKING:
    from topcli.config.ensemble import EnsembleExperiment, Members
    from topcli.contracts import Top

MAX_BYTES = 1_000_000
SUFFIXES = (".yaml", ".yml", ".toml")


Changes = Mapping[str, Any] | None
"""Values that replace top-level keys of a config."""


def load_experiment(
    source: Path | str, overrides: Sequence[str] = (), changes: Changes = None, *, any_precision: bool = False
) -> Experiment:
    """Load the experiment of a config file (.yaml, .yml, .toml) or of a packaged scene such as ``kowalevski_hk``.

    ``changes`` replace whole keys; ``overrides``, which are ``key=value`` texts, are applied after them and before the
    config is validated. A precision other than double is refused unless the caller computes with it
    (``any_precision``). Raises ConfigError or UnknownNameError with ``file:line``, the key, what is wrong and what
    would be right; also for an ensemble, which ``load_any`` loads.
    """
    document, name = _named_document(source, overrides, changes)
    found = _single(document, name)
    return found if any_precision else _in_doubles(found, document)


def _in_doubles(found: Experiment, document: Document) -> Experiment:
    """Return an experiment that is computed in doubles. Raises ConfigError for another precision."""
    if found.precision != DOUBLE:
        problems = Problems(document)
        problems.add(
            ("precision",),
            "computed in doubles here; `topcli run`, `topcli compare` and topcli.simulate take another precision",
        )
        problems.raise_any()
    return found


def load_any(
    source: Path | str, overrides: Sequence[str] = (), changes: Changes = None
) -> Experiment | EnsembleExperiment:
    """Load the experiment or ensemble of a config file or of a packaged scene. Raises as ``load_experiment``."""
    return _experiment(*_named_document(source, overrides, changes))


def load_named(
    source: Path | str, overrides: Sequence[str] = (), name: str | None = None
) -> Experiment | EnsembleExperiment:
    """Load the experiment or ensemble of a run, under ``name`` or the name that it gets by default.

    That is the name of the config; if the overrides change what is computed or recorded, with the first digits of the
    digest: ``kowalevski_hybrid-3f2a9c``. An override of the name wins. Raises as ``load_experiment``.
    """
    given = next((text for text in overrides if parse_override(text)[0] == ("name",)), None)
    if name is not None:
        if given is not None:
            raise UsageError(f"--name {quoted(name)}: {override_label(given)} names the run too; keep one of them")
        if fault := name_fault(name):
            raise UsageError(f"--name {fault}")
    return load_changed(source, overrides, {} if name is None else {"name": name})


def load_changed(
    source: Path | str, overrides: Sequence[str] = (), changes: Changes = None
) -> Experiment | EnsembleExperiment:
    """Load an experiment or ensemble, renamed if ``changes`` or ``overrides`` change it without naming it."""
    found = load_any(source, overrides, changes)
    named = "name" in (changes or {}) or any(parse_override(text)[0] == ("name",) for text in overrides)
    if named or not (overrides or changes):
        return found
    try:
        base = load_any(source).digest
    except TopcliError:  # the changes complete or correct it
        base = ""
    return found if found.digest == base else found.renamed(changed_name(found.name, found.digest))


def config_data(source: Path | str, overrides: Sequence[str] = (), changes: Changes = None) -> dict[str, Any]:
    """Return the content of a config or packaged scene, named, as plain data that is not validated yet."""
    document, name = _named_document(source, overrides, changes)
    return {"name": name, **document.data}


def experiment_from(
    data: Mapping[str, Any], overrides: Sequence[str] = (), *, any_precision: bool = True
) -> Experiment:
    """Return the experiment of a config given as a dict; its default name is made of its top and scheme.

    Lists may be tuples or numpy arrays. Raises as ``load_experiment``; the messages name the key.
    """
    document = _document(data, overrides)
    found = _single(document, None)
    return found if any_precision else _in_doubles(found, document)


def any_from(data: Mapping[str, Any], overrides: Sequence[str] = ()) -> Experiment | EnsembleExperiment:
    """Return the experiment or ensemble of a config given as a dict. Raises as ``experiment_from``."""
    return _experiment(_document(data, overrides), None)


def scene_folder() -> Path:
    """Folder of the scenes: inside the package if a wheel installed it, otherwise ``configs`` of the checkout."""
    package = Path(__file__).resolve().parents[1]
    inside = package / "scenes"
    return inside if inside.is_dir() else package.parents[1] / "configs"


def scene_files() -> dict[str, Path]:
    """Files of the packaged scenes by name; a scene is a config that needs no path."""
    folder = scene_folder()
    if not folder.is_dir():
        return {}
    return {path.stem: path for path in sorted(folder.iterdir()) if path.suffix in SUFFIXES}


def scenes(top: str | None = None) -> Iterator[tuple[str, Experiment, int, str]]:
    """Yield name, first trajectory, number of trajectories and description of each packaged scene.

    ``top`` restricts them to one top. Raises UnknownNameError for an unknown top.
    """
    wanted = [form.form for form in forms(top)] if top else list(TOPS)
    for name, path in scene_files().items():
        one = load_any(path)
        first, count = (one, 1) if isinstance(one, Experiment) else (one.first, one.count)
        if first.top.form in wanted:
            yield name, first, count, first_sentence(path)


def first_sentence(path: Path) -> str:
    """Return the first sentence of the comment at the top of a config; empty if there is none."""
    lines = itertools.takewhile(lambda line: line.startswith("#"), path.read_text(encoding="utf-8").splitlines())
    words = " ".join(line.removeprefix("#").strip() for line in lines)
    return words.split(". ")[0].removesuffix(".")


def find_config(source: Path | str) -> Path:
    """Return the file of ``source``: itself if it is named like a config, otherwise the scene of that name.

    Scenes are matched without case, and with - for _. Raises UnknownNameError with the nearest scenes.
    """
    path = Path(source)
    if path.suffix.lower() in SUFFIXES:
        return path
    text = os.fspath(source)
    if not text or path.suffix or os.sep in text or "/" in text:
        return path  # reading it reports what is wrong with it
    scenes = scene_files()
    wanted = text.lower().replace("-", "_")
    for name, scene in scenes.items():
        if name.lower().replace("-", "_") == wanted:
            return scene
    files = [text + suffix for suffix in SUFFIXES if os.path.isfile(text + suffix)]
    near = f"did you mean the file {files[0]}?" if files else nearest(wanted, scenes, "topcli list scenes")
    raise UnknownNameError(f"no packaged scene is called {quoted(text)} (files end in .yaml, .yml or .toml); {near}")


def is_config(name: str) -> bool:
    """True if ``name`` is that of an existing config file or of a packaged scene."""
    try:
        return os.path.isfile(find_config(name))
    except UnknownNameError:
        return False


def read_text(path: Path) -> str:
    """Return the text of a config file, with line ends as ``\\n`` and without a byte-order mark.

    Raises ConfigError for a missing file (with the nearest names beside it), a folder, a special, unreadable
    or too large file, and for bytes that are not UTF-8 text.
    """
    try:
        status = path.stat()
        if stat.S_ISDIR(status.st_mode):
            raise ConfigError(f"{path}: is a folder; give a config file (.yaml, .yml or .toml)")
        if not stat.S_ISREG(status.st_mode):
            raise ConfigError(f"{path}: is not a regular file; give a config file (.yaml, .yml or .toml)")
        if status.st_size > MAX_BYTES:
            raise ConfigError(f"{path}: {status.st_size} bytes; a config is at most {MAX_BYTES}")
        content = path.read_bytes()
    except FileNotFoundError:
        raise ConfigError(f"{path}: no such file{_files_nearby(path)}") from None
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
        raise ConfigError(f"{path}: cannot be read: {reason}") from None
    if b"\0" in content:
        raise ConfigError(f"{path}: is a binary file; a config is UTF-8 text")
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        raise ConfigError(
            f"{path}:{line}: is not UTF-8 text (byte 0x{content[error.start]:02x}); a config is UTF-8 text"
        ) from None
    return text.replace("\r\n", "\n")


def _files_nearby(path: Path) -> str:
    """End of a message about a missing file: the configs in its folder; empty if there are none."""
    try:
        names = sorted(entry for entry in os.listdir(path.parent) if entry.endswith(SUFFIXES))
    except (OSError, ValueError):
        return f"; nor is there a folder {path.parent}"
    # by their stems, because the common ending makes any two names look alike
    stems = {Path(name).stem: name for name in names}
    close = [stems[stem] for stem in difflib.get_close_matches(path.stem, stems, n=2)]
    if close:
        return f"; did you mean {' or '.join(map(quoted, close))}?"
    return (
        f"; configs there: {', '.join(map(shortened, names[:5]))}{', ...' if len(names) > 5 else ''}" if names else ""
    )


def read_document(path: Path) -> Document:
    """Read a YAML or TOML config file.

    Raises ConfigError with ``file:line:column`` for wrong syntax, and as ``read_text`` does.
    """
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        inside = path / "config.yaml"
        known = (
            f"; that of this run is {inside}" if os.path.isfile(inside) else "; its name ends in .yaml, .yml or .toml"
        )
        raise ConfigError(f"{path}: not a config{known}")
    text = read_text(path)
    if suffix == ".toml":
        from topcli.config.toml_text import parse_toml

        data, lines = parse_toml(text, str(path))
    else:
        data, lines = parse_yaml(text, str(path))
    if data is None or data == {}:
        raise ConfigError(f"{path}: is empty; `topcli init` writes a config to start from")
    if not isinstance(data, dict):
        raise ConfigError(f"{path}:1: a config is a list of `key: value` lines, not {describe(data)}")
    places: dict[KeyPath, str] = {key: f"{path}:{line}" for key, line in lines.items()}
    places.setdefault((), f"{path}:{min(lines.values(), default=1)}")
    document = Document(data, places)
    if suffix == ".toml":  # which has dates, and no bounds
        document.data = plain(data, document)
    return document


def _named_document(source: Path | str, overrides: Sequence[str], changes: Changes) -> tuple[Document, str]:
    """Document of a file or scene with changes and overrides, and the default name of its experiment."""
    path = find_config(source)
    document = read_document(path)
    if changes:
        new = Document({})
        new.data = plain(changes, new)
        drop_partner(document.data, new.data)
        document.data |= new.data
        document.places = {key: place for key, place in document.places.items() if not key or key[0] not in new.data}
        document.places |= {(key,): "" for key in new.data}
    apply_overrides(document, overrides)
    return document, path.stem


def _document(data: Mapping[str, Any], overrides: Sequence[str]) -> Document:
    if not isinstance(data, Mapping):
        raise ConfigError(f"a config is a dict with the keys {', '.join(Config.model_fields)}")
    document = Document({})
    document.data = plain(data, document)
    apply_overrides(document, overrides)
    return document


def _single(document: Document, default_name: str | None) -> Experiment:
    """Return the experiment of a document that must not be an ensemble."""
    found = _experiment(document, default_name)
    if not isinstance(found, Experiment):
        problems = Problems(document)
        problems.add(
            ("ensemble",),
            f"this is an ensemble of {found.count} trajectories, and a single one is needed here; "
            "`topcli run`, `topcli compare` and topcli.simulate_ensemble take ensembles",
        )
        problems.raise_any()
    assert isinstance(found, Experiment)
    return found


def _experiment(document: Document, default_name: str | None) -> Experiment | EnsembleExperiment:
    """Return the experiment or ensemble of a document. Raises as ``load_experiment``."""
    problems = Problems(document)
    if "base" in document.data:
        problems.add(("base",), "this is a sweep, and an experiment is needed here; `topcli sweep` takes sweeps")
        problems.raise_any()
    optional = ("name", "output", "ensemble", "T", "precision", "max_digits")
    data = {key: value for key, value in document.data.items() if key not in optional or value is not None}
    data = with_written_numbers(data)
    if "name" not in data and default_name is not None:
        if fault := name_fault(default_name):
            problems.add(("name",), f"missing, and the file name cannot be used instead: it {fault}")
        data["name"] = "unnamed" if fault else default_name
    if "ensemble" in data:
        data.setdefault("initial", {})
    config = _config(data, problems)
    cls, top = _top(data, problems)
    scheme = state = members = columns = None
    if cls and "scheme" in data:
        scheme = read_scheme(data["scheme"], cls, problems)
    if cls and "ensemble" in data:
        members = _members(data, cls, top, problems)
        state = members.groups[0].state(0) if members else None
    elif cls and "initial" in data:
        state = read_initial(data["initial"], cls, problems)
    if config:
        if config.output.every > config.N:
            problems.add(("output", "every"), f"must be at most N = {config.N}, not {config.output.every}")
        if too_long := duration_fault(config.h, config.N):
            problems.add(("N",), too_long)
        if top and scheme:
            integrals = top.invariants() + (scheme[0].modified(top, config.h, scheme[1]) if scheme[0].modified else ())
            columns = read_columns(config.output, top.components, integrals, problems)
        _check_precision(config, members is not None, problems)
        _check_attitude(config, top, members is not None, problems)
    exact = None
    if config and config.precision != DOUBLE and top and state and not problems.messages:
        exact = read_exact(data, top, state, config.precision, problems)
    problems.raise_any()
    # a missing part has been raised as a problem
    assert config is not None
    assert top is not None
    assert state is not None
    assert scheme is not None
    experiment = Experiment(
        name=config.name or f"{top.kind}_{scheme[0].name}".replace("-", "_"),
        top=top,
        y0=state,
        scheme=scheme[0],
        options=scheme[1],
        h=config.h,
        N=config.N,
        output=config.output.model_copy(update={"columns": columns}),
        precision=config.precision,
        max_digits=config.max_digits or MAX_DIGITS,
        exact=exact,
    )
    if members is None:
        _require_short_step(experiment, document)
        return experiment
    from topcli.config.ensemble import EnsembleExperiment

    first = experiment.model_copy(update={"top": members.groups[0].top})
    return EnsembleExperiment(first, members, experiment.top)


def _require_short_step(experiment: Experiment, document: Document) -> None:
    """Raise StepTooLongError if the scheme cannot take the step h from the initial state."""
    scheme, h = experiment.scheme, experiment.h
    longest = (
        scheme.longest_step(experiment.top, experiment.y0, experiment.options) if scheme.longest_step else math.inf
    )
    if abs(h) <= longest:
        return
    auto = ", or set scheme.substeps: auto" if "substeps" in scheme.options.model_fields else ""
    text = f"no step is possible under {scheme.name} from this state"
    if longest > 0.0:
        digit = 10.0 ** (math.floor(math.log10(longest)) - 3)
        most = math.floor(longest / digit) * digit  # rounded down, so that it is admissible
        text = f"|h| must be at most {most:.4g} under {scheme.name} from this state, not {abs(h):g}{auto}"
    raise StepTooLongError(": ".join(part for part in (document.place(("h",)), "h", text) if part))


def _config(data: dict[str, Any], problems: Problems) -> Config | None:
    """Return the keys of the top level, with N from T; None if one is wrong."""
    if "T" in data and "N" in data:
        where = problems.document.place(("N",))
        problems.add(("T",), f"N is given too{f' ({where})' if where else ''}; keep one of them")
        data = {key: value for key, value in data.items() if key != "T"}
    config = validate(Config, {"N": 1, **data} if "T" in data else data, (), problems)
    if config is None or config.T is None:
        return config
    try:
        return config.model_copy(update={"N": steps_of(config.T, config.h), "T": None})
    except UsageError as error:
        problems.add(("T",), str(error))
        return None


def _check_precision(config: Config, is_ensemble: bool, problems: Problems) -> None:
    """Add the mistakes in ``precision`` and the keys that depend on it."""
    if config.precision != DOUBLE and is_ensemble:
        problems.add(("precision",), "an ensemble runs in doubles only; run single trajectories in another precision")
    if config.max_digits is not None and config.precision != RATIONAL:
        problems.add(("max_digits",), "needs precision: rational; other numbers have a fixed number of digits")
    if config.output.digits is not None and config.precision == DOUBLE:
        problems.add(("output", "digits"), "needs another precision than double, such as precision: 50")


def _check_attitude(config: Config, top: Top | None, is_ensemble: bool, problems: Problems) -> None:
    """Add the reason why ``output.attitude`` cannot be recorded, if there is one."""
    where, names = ("output", "attitude"), config.output.attitude_columns
    if not names:
        return
    if is_ensemble:
        problems.add(where, "an ensemble records no attitude; run single trajectories with it")
    elif config.precision != DOUBLE:
        problems.add(where, "the attitude is computed in doubles only; leave out precision or the attitude")
    elif top is not None:
        try:
            checked_equations(top, "the attitude")
        except UsageError as error:
            problems.add(where, str(error))
        taken = [name for name in names if name in top.components]
        if taken:
            problems.add(where, f"the top has a component {quoted(taken[0])} of its own; use another form")


def _top(data: dict[str, Any], problems: Problems) -> tuple[type[Top] | None, Top | None]:
    """Return the class of the top and the top; None for each that is missing or cannot be read."""
    if "top" not in data:
        return None, None
    named = data.get("initial")
    if "ensemble" in data and isinstance(named, dict):
        from topcli.config.members import vectors_named

        named = dict.fromkeys(vectors_named(data["ensemble"])) | named
    return read_top(data["top"], named, problems)


def _members(data: dict[str, Any], cls: type[Top], top: Top | None, problems: Problems) -> Members | None:
    """Return the members of the ensemble; None if they, or the top, are wrong."""
    from topcli.config.members import read_members

    if top is None:
        return None
    parameters = data["top"] if isinstance(data["top"], dict) else {}
    return read_members(data["ensemble"], data["initial"], cls, top, parameters, problems)
