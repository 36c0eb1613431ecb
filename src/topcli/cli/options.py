"""Options shared by several commands, completion of names, hints for misplaced ones, and files that a user names."""

from __future__ import annotations

import os
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.models import OptionInfo

from topcli.errors import UnknownNameError, UsageError, nearest, quoted

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence


def complete_scheme(incomplete: str) -> list[str]:
    """Names of schemes that begin with ``incomplete``; after a +, names of compositions of the scheme."""
    from topcli.schemes.registry import all_schemes

    base, plus, _ = incomplete.lower().partition("+")
    if plus:
        from topcli.schemes.compose import COMPOSITIONS, obstacle

        fits = any(scheme.name == base and not obstacle(scheme) for scheme in all_schemes())
        names = [f"{base}+{name}" for name in COMPOSITIONS if fits]
    else:
        names = sorted({scheme.name for scheme in all_schemes()})
    return [name for name in names if name.startswith(incomplete.lower())]


def complete_top(incomplete: str) -> list[str]:
    """Names of tops that begin with ``incomplete``."""
    from topcli.schemes.own_tops import top_names

    return [name for name in sorted(top_names()) if name.startswith(incomplete.lower())]


def complete_figure(incomplete: str) -> list[str]:
    """Names of figures that begin with ``incomplete``."""
    from topcli.figures.catalogue import FIGURES

    return [name for name in FIGURES if name.startswith(incomplete.lower())]


def complete_config(incomplete: str) -> list[str]:
    """Config files in the working folder's ``configs`` and the packaged scenes that begin with ``incomplete``."""
    from topcli.config.files import scene_files

    own_files = [str(path) for path in sorted(Path("configs").glob("*.*"))]
    return [name for name in [*own_files, *scene_files()] if name.startswith(incomplete)]


HELP = {
    "--config": "Read the experiment from a config or scene.",
    "--dry-run": "Print the plan and run nothing.",
    "--force": "Replace existing results or files.",
    "--format": "Write files in this format.",
    "--json": "Print the result as one JSON document.",
    "--out": "Write the result here.",
    "--plot": "Also draw to a .png, .pdf or .svg file.",
    "--quiet": "Print only errors.",
    "--results": "Look for stored results in this folder.",
    "--save": "Also write the result to a .json, .csv, .md or .tex file.",
    "--set": "Set a config key, e.g. h=0.01, T=20 or scheme.branch=sign.",
    "--steps": "Set the number of steps of a run, e.g. 1e6.",
    "--table": "Show only this table of the result.",
    "--threads": "Compute with this number of threads.",
    "--top": "Choose a top.",
    "--verbose": "Print all columns and tables of the result.",
}
"""Help of each option that several commands have, which is the same for all of them."""


def option(*names: str, **attributes: Any) -> OptionInfo:
    """The option ``names[0]`` with its shared help; ``default`` says in words what its absence means."""
    if default := attributes.pop("default", ""):
        attributes["show_default"] = default
    return typer.Option(*names, help=HELP[names[0]], **attributes)


def config_option(default: str = "") -> OptionInfo:
    """Option ``--config``."""
    return option("--config", metavar="CONFIG", default=default, autocompletion=complete_config)


def top_option(default: str = "") -> OptionInfo:
    """Option ``--top``."""
    return option("--top", metavar="TOP", default=default, autocompletion=complete_top)


def format_option(*formats: str, default: str = "") -> OptionInfo:
    """Option ``--format`` of a command that writes one of the ``formats``."""
    return option("--format", metavar="|".join(formats), default=default)


Sets = Annotated[list[str] | None, option("--set", metavar="KEY=VALUE")]
Json = Annotated[bool, option("--json")]
Quiet = Annotated[bool, option("--quiet", "-q")]
Verbose = Annotated[bool, option("--verbose", "-v")]
DryRun = Annotated[bool, option("--dry-run")]
Threads = Annotated[int | None, option("--threads", metavar="COUNT", min=1, default="all CPUs")]
Out = Annotated[Path, option("--out", metavar="DIR")]
OutFile = Annotated[Path, option("--out", metavar="FILE")]
Results = Annotated[Path, option("--results", metavar="DIR")]
Force = Annotated[bool, option("--force")]
Save = Annotated[Path | None, option("--save", metavar="FILE")]
Plot = Annotated[Path | None, option("--plot", metavar="FILE")]
PictureFormats = Annotated[list[str] | None, format_option("png", "pdf", "svg", default="png and pdf")]


def picture_formats(formats: Sequence[str] | None) -> tuple[str, ...]:
    """Formats of pictures, each once; the default ones for None. Raises UsageError."""
    from topcli.figures.figure import DEFAULT_FORMATS, IMAGE_FORMATS

    for name in formats or ():
        if name not in IMAGE_FORMATS:
            raise UsageError(f"--format {quoted(name)}: unknown format; use png, pdf or svg")
    return tuple(dict.fromkeys(formats or DEFAULT_FORMATS))


def place_of(name: str | Path, results: Path) -> Path:
    """Path that ``name`` is, or the path of the stored result of this name in the folder ``results``."""
    inside = results / name
    return inside if not os.path.lexists(name) and os.path.lexists(inside) else Path(name)


def stored_place(name: str | Path, results: Path) -> Path:
    """Return ``place_of`` a stored result, finished or not. Raises UsageError if there is nothing."""
    from topcli.sweeps.store import missing_result

    place = place_of(name, results)
    if not os.path.lexists(place):
        raise missing_result(str(name), results)
    return place


def require_new(path: Path, force: bool, option: str = "--out") -> None:
    """Raise UsageError if ``path`` exists and may not be overwritten, or is a folder."""
    from topcli.store import files

    if os.path.isdir(path):
        raise UsageError(f"{option} {path}: is a folder; name a file")
    if not force:
        files.require_new([path], option)


def write_text(text: str, path: Path, option: str = "--out") -> None:
    """Write a file whole or not at all, and its folder if there is none. Raises UsageError."""
    from topcli.store import files

    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        files.write_text(path, text)
    except OSError as error:
        raise UsageError(f"{option} {path}".lstrip() + f": cannot be written ({error.strerror})") from None


@contextmanager
def hint_instead(names: Sequence[str], hint: Callable[[str], str]) -> Iterator[None]:
    """Replace an error about one of ``names`` by its hint; an error about another name remains."""
    try:
        yield
    except UnknownNameError as error:
        message = next((text for name in names if quoted(name) in str(error) and (text := hint(name))), "")
        if not message:
            raise
        raise UsageError(message) from error


def stored_folder(name: str, results: Path) -> Path | None:
    """Folder of a run or sweep that ``name`` is the path of, or its name in ``results``; None if there is none."""
    from topcli.store.results import read_result
    from topcli.sweeps.store import is_sweep

    folders = (Path(name), results / name) if name else ()
    return next(
        (folder for folder in folders if os.path.isdir(folder) and (is_sweep(folder) or read_result(folder))), None
    )


def plot_hint(name: str, results: Path) -> str:
    """Message about ``name`` given instead of a figure: the command that draws it; empty if it is unknown."""
    from topcli.config.files import is_config
    from topcli.sweeps.store import is_sweep

    folder = stored_folder(name, results)
    if folder is not None and is_sweep(folder):
        return f"{quoted(name)} is a sweep, not a figure; draw it with: topcli plot sweep {folder} --x KEY --y MEASURE"
    if is_config(name):
        draw = "topcli plot NAME"
        return (
            f"{quoted(name)} is a config, not a figure; run it with `topcli run {name}` and draw the run with `{draw}`"
        )
    return ""


def show_hint(name: str) -> str:
    """Message about ``name`` given instead of a config or scheme; empty if it is unknown."""
    from topcli.config.files import is_config, scene_files
    from topcli.figures.catalogue import FIGURES
    from topcli.schemes.registry import all_schemes

    if is_config(name):  # the error is about another name
        return ""
    folder = stored_folder(name, Path("results"))
    if folder is not None:
        return f"{quoted(name)} is a stored run or sweep; show its config with: topcli show {folder}"
    if name.lower() in FIGURES:
        return f"{quoted(name)} is a figure; draw it with: topcli plot {name.lower()}"
    hint = nearest(name, {*scene_files(), *(scheme.name for scheme in all_schemes())}, "topcli list")
    if not hint.startswith("did you mean"):
        hint = "see `topcli list scenes` and `topcli list schemes`"
    return f"no packaged scene and no scheme is called {quoted(name)} (configs end in .yaml, .yml or .toml); {hint}"
