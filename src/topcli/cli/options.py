"""Options shared by several commands, and completion of names."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from typer.models import OptionInfo


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

    near = [str(path) for path in sorted(Path("configs").glob("*.*"))]
    return [name for name in [*near, *scene_files()] if name.startswith(incomplete)]


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
SchemeFiles = Annotated[
    list[Path] | None,
    typer.Option("--scheme-file", metavar="FILE", help="Load your own schemes or measures from a Python file."),
]


def load_scheme_files(paths: list[Path] | None) -> None:
    """Register what the files given by ``--scheme-file`` define."""
    if paths:
        from topcli.schemes.registry import load_scheme_file

        for path in paths:
            load_scheme_file(path)
