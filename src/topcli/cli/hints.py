"""Hints for an argument that names something that another command takes: a run, a sweep, a config, a figure, a top."""

from __future__ import annotations

import os
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from topcli.errors import UnknownNameError, UsageError, nearest, quoted

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence


@contextmanager
def hint_instead(names: Sequence[str], hint: Callable[[str], str]) -> Iterator[None]:
    """Replace an error about one of ``names`` by its hint; an error about another name remains."""
    try:
        yield
    except UnknownNameError as error:
        found = next((text for name in names if quoted(name) in str(error) and (text := hint(name))), "")
        if not found:
            raise
        raise UsageError(found) from error


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
    from topcli.tops import top_names

    if is_config(name):  # the error is about another name
        return ""
    folder = stored_folder(name, Path("results"))
    if folder is not None:
        return f"{quoted(name)} is a stored run or sweep; show its config with: topcli show {folder}"
    if name.lower() in FIGURES:
        return f"{quoted(name)} is a figure; draw it with: topcli plot {name.lower()}"
    if name.lower() in top_names():
        top = name.lower()
        return (
            f"{quoted(name)} is a top; see `topcli list schemes --top {top}`, or start with `topcli init --top {top}`"
        )
    near = nearest(name, {*scene_files(), *(scheme.name for scheme in all_schemes())}, "topcli list")
    if not near.startswith("did you mean"):
        near = "see `topcli list scenes` and `topcli list schemes`"
    return f"no packaged scene and no scheme is called {quoted(name)} (configs end in .yaml, .yml or .toml); {near}"
