"""Options shared by several commands, completion of names, hints for misplaced ones, and files that a user names."""

from __future__ import annotations

import os
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

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
    from topcli.tops import top_names

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


Schemes = Annotated[
    list[str] | None,
    typer.Argument(metavar="SCHEME", help="Names of schemes; all by default.", autocompletion=complete_scheme),
]


def config_option(text: str) -> OptionInfo:
    """Option ``--config`` with the help ``text``."""
    return typer.Option("--config", metavar="CONFIG", help=text, autocompletion=complete_config)


def top_option(text: str) -> OptionInfo:
    """Option ``--top`` with the help ``text``."""
    return typer.Option("--top", metavar="TOP", help=text, autocompletion=complete_top)


Sets = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="KEY=VALUE",
        help="Override a key of the config, e.g. h=0.01, top.c0=-1, scheme.branch=sign.",
    ),
]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON document on stdout.")]
Out = Annotated[Path, typer.Option("--out", metavar="DIR", help="Read and write run folders in this folder.")]
FigureOut = Annotated[Path, typer.Option("--out", metavar="DIR", help="Write figures into this folder.")]
Force = Annotated[
    bool,
    typer.Option("--force", help="Run again; an existing different run is renamed, not overwritten."),
]
Overwrite = Annotated[bool, typer.Option("--force", help="Overwrite an existing file.")]


def require_new(path: Path, force: bool, option: str = "--out") -> None:
    """Raise UsageError if ``path`` exists and may not be overwritten, or is a folder."""
    from topcli.errors import UsageError

    if os.path.isdir(path):
        raise UsageError(f"{option} {path}: is a folder; name a file")
    if os.path.lexists(path) and not force:
        raise UsageError(f"{option} {path}: exists already; choose another file, or use --force to overwrite it")


def write_text(text: str, path: Path, option: str = "--out") -> None:
    """Write a file whole or not at all, and its folder if there is none. Raises UsageError."""
    from topcli.errors import UsageError
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
    from topcli.store.manifest import read_run
    from topcli.sweeps.run import is_sweep

    folders = (Path(name), results / name) if name else ()
    return next(
        (folder for folder in folders if os.path.isdir(folder) and (read_run(folder) or is_sweep(folder))), None
    )


def plot_hint(name: str, results: Path) -> str:
    """Message about ``name`` given instead of a figure: the command that draws it; empty if it is unknown."""
    from topcli.config.files import is_config
    from topcli.sweeps.run import is_sweep

    folder = stored_folder(name, results)
    if folder is not None and is_sweep(folder):
        return f"{quoted(name)} is a sweep, not a figure; draw it with: topcli plot sweep {folder} --x KEY --y MEASURE"
    if folder is not None:
        return f"{quoted(name)} is a run, not a figure; draw it with: topcli report {folder} --out {folder.name}.html"
    if is_config(name):
        draw = "topcli report results/NAME --out NAME.html"
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
