"""From a config file, a packaged scene or a dict to a validated ``Experiment``."""

from __future__ import annotations

import itertools
import os
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from topcli.config.document import Document, plain
from topcli.config.files import SUFFIXES, read_document
from topcli.config.models import Config, Experiment, duration_fault, name_fault
from topcli.config.overrides import apply_overrides
from topcli.config.problems import Problems, validate
from topcli.config.sections import read_columns, read_initial, read_scheme, read_top
from topcli.errors import ConfigError, UnknownNameError, nearest, quoted
from topcli.tops import TOPS, forms

if TYPE_CHECKING:
    from topcli.config.ensemble import EnsembleExperiment


def load_experiment(source: Path | str, overrides: Sequence[str] = ()) -> Experiment:
    """The experiment of a config file (.yaml, .yml, .toml) or of a packaged scene such as ``kowalevski_hk``.

    ``overrides`` are ``key=value`` texts, applied before the config is validated.
    Raises ConfigError or UnknownNameError with ``file:line``, the key, what is wrong and what would be right; also for
    an ensemble, which ``load_any`` loads.
    """
    path = find_config(source)
    document = read_document(path)
    apply_overrides(document, overrides)
    return _single(document, path.stem)


def load_any(source: Path | str, overrides: Sequence[str] = ()) -> Experiment | EnsembleExperiment:
    """The experiment, or the ensemble, of a config file or of a packaged scene. Raises as ``load_experiment``."""
    path = find_config(source)
    document = read_document(path)
    apply_overrides(document, overrides)
    return _experiment(document, path.stem)


def experiment_from(data: Mapping[str, Any], overrides: Sequence[str] = ()) -> Experiment:
    """The experiment of a config given as a dict; without a name it is called after its top and scheme.

    Lists may be tuples or numpy arrays. Raises as ``load_experiment``; the messages name the key.
    """
    return _single(_document(data, overrides), None)


def any_from(data: Mapping[str, Any], overrides: Sequence[str] = ()) -> Experiment | EnsembleExperiment:
    """The experiment, or the ensemble, of a config given as a dict. Raises as ``experiment_from``."""
    return _experiment(_document(data, overrides), None)


def _document(data: Mapping[str, Any], overrides: Sequence[str]) -> Document:
    if not isinstance(data, Mapping):
        raise ConfigError(f"a config is a dict with the keys {', '.join(Config.model_fields)}")
    document = Document({})
    document.data = plain(data, document)
    apply_overrides(document, overrides)
    return document


def _single(document: Document, default_name: str | None) -> Experiment:
    """The experiment of a document that must not be an ensemble."""
    found = _experiment(document, default_name)
    if not isinstance(found, Experiment):
        problems = Problems(document)
        problems.add(
            ("ensemble",),
            f"this is an ensemble of {found.count} trajectories, and a single one is needed here; "
            "`topcli run` and topcli.simulate_ensemble take ensembles",
        )
        problems.raise_any()
    assert isinstance(found, Experiment)
    return found


def scene_folder() -> Path:
    """The folder of the scenes: inside the package when a wheel installed it, else ``configs`` of the checkout."""
    package = Path(__file__).resolve().parents[1]
    inside = package / "scenes"
    return inside if inside.is_dir() else package.parents[1] / "configs"


def scene_files() -> dict[str, Path]:
    """The packaged scenes by name: configs that are found without a path."""
    folder = scene_folder()
    if not folder.is_dir():
        return {}
    return {path.stem: path for path in sorted(folder.iterdir()) if path.suffix in SUFFIXES}


def scenes(top: str | None = None) -> Iterator[tuple[str, Experiment, int, str]]:
    """The packaged scenes, those of ``top`` where one is named: name, first trajectory, their number, a sentence.

    Raises UnknownNameError for an unknown top.
    """
    wanted = [form.form for form in forms(top)] if top else list(TOPS)
    for name, path in scene_files().items():
        one = load_any(path)
        first, count = (one, 1) if isinstance(one, Experiment) else (one.first, one.count)
        if first.top.form in wanted:
            yield name, first, count, _first_sentence(path)


def _first_sentence(path: Path) -> str:
    """The first sentence of the comment that a config begins with; empty where there is none."""
    lines = itertools.takewhile(lambda line: line.startswith("#"), path.read_text(encoding="utf-8").splitlines())
    words = " ".join(line.removeprefix("#").strip() for line in lines)
    return words.split(". ")[0].removesuffix(".")


def find_config(source: Path | str) -> Path:
    """The file of ``source``: itself when it is named like a config, else the scene of that name.

    Scenes are matched without case, and with - for _. Raises UnknownNameError with the nearest scenes.
    """
    path = Path(source)
    if path.suffix.lower() in SUFFIXES:
        return path
    text = os.fspath(source)
    if not text or path.suffix or os.sep in text or "/" in text:
        return path  # reading it says what is wrong with it
    scenes = scene_files()
    wanted = text.lower().replace("-", "_")
    for name, scene in scenes.items():
        if name.lower().replace("-", "_") == wanted:
            return scene
    files = [text + suffix for suffix in SUFFIXES if os.path.isfile(text + suffix)]
    near = f"did you mean the file {files[0]}?" if files else nearest(wanted, scenes)
    raise UnknownNameError(f"no packaged scene is called {quoted(text)} (files end in .yaml, .yml or .toml); {near}")


def _experiment(document: Document, default_name: str | None) -> Experiment | EnsembleExperiment:
    problems = Problems(document)
    optional = ("name", "output", "ensemble")
    data = {key: value for key, value in document.data.items() if key not in optional or value is not None}
    if "name" not in data and default_name is not None:
        if fault := name_fault(default_name):
            problems.add(("name",), f"missing, and the file's own name does not serve: it {fault}")
        data["name"] = "unnamed" if fault else default_name
    many = data.get("ensemble")
    if many is not None:
        data.setdefault("initial", {})
    config = validate(Config, data, (), problems)
    cls = top = state = scheme = members = columns = None
    initial = data.get("initial")
    if "top" in data:
        named = initial
        if many is not None and isinstance(initial, dict):
            from topcli.config.members import vectors_named

            named = dict.fromkeys(vectors_named(many)) | initial
        cls, top = read_top(data["top"], named, problems)
    if cls and "scheme" in data:
        scheme = read_scheme(data["scheme"], cls, problems)
    if cls and many is not None:
        from topcli.config.members import read_members

        parameters = data["top"] if isinstance(data["top"], dict) else {}
        members = read_members(many, initial, cls, top, parameters, problems) if top else None
        state = members.groups[0].state(0) if members else None
    elif cls and "initial" in data:
        state = read_initial(initial, cls, problems)
    if config:
        if config.output.every > config.N:
            problems.add(("output", "every"), f"must be at most N = {config.N}, not {config.output.every}")
        if too_long := duration_fault(config.h, config.N):
            problems.add(("N",), too_long)
        if top and scheme:
            integrals = top.invariants() + (scheme[0].modified(top, config.h, scheme[1]) if scheme[0].modified else ())
            columns = read_columns(config.output.columns, top.components, integrals, problems)
    problems.raise_any()
    # what is missing here has been raised as a problem
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
    )
    if members is None:
        return experiment
    from topcli.config.ensemble import EnsembleExperiment

    first = experiment.model_copy(update={"top": members.groups[0].top})
    return EnsembleExperiment(first, members, experiment.top)
