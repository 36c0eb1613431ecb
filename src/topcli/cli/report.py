"""``topcli report``: write a page on stored results."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from topcli.cli.files import Overwrite, require_new, write_text
from topcli.cli.options import Json, SchemeFiles, load_scheme_files
from topcli.cli.output import print_json, print_message


def complete_result(incomplete: str) -> list[str]:
    """Names of the results in ``results`` that begin with ``incomplete``."""
    folder = Path("results")
    try:
        folders = [path.name for path in sorted(folder.iterdir()) if path.is_dir()]
    except OSError:
        return []
    return [name for name in folders if name.startswith(incomplete)]


Places = Annotated[
    list[str],
    typer.Argument(
        metavar="RUN...",
        help="Folders of runs or sweeps, or JSON files of studies.",
        autocompletion=complete_result,
    ),
]
OutFile = Annotated[Path, typer.Option("--out", metavar="FILE", help="Write the page to this file, FILE.html.")]
Results = Annotated[Path, typer.Option("--results", metavar="DIR", help="Find results by name in this folder.")]
Title = Annotated[
    str | None,
    typer.Option("--title", metavar="TEXT", help="Title of the page.", show_default="the names of the results"),
]


def report(
    places: Places,
    out: OutFile,
    results: Results = Path("results"),
    title: Title = None,
    force: Overwrite = False,
    as_json: Json = False,
    scheme_files: SchemeFiles = None,
) -> None:
    """Write one self-contained HTML page on stored results.

    Results are runs, ensembles, sweeps, benchmarks, and JSON files of compare, order and stress. The page loads nothing
    from elsewhere. Runs of the same top are compared in a table. What is missing of an unfinished or damaged result is
    said on the page.
    """
    from topcli.errors import UsageError
    from topcli.pages.find import report_page

    if out.suffix.lower() not in (".html", ".htm"):
        raise UsageError(f"--out {out}: unknown type of page; use a name ending in .html")
    require_new(out, force)
    load_scheme_files(scheme_files)
    page = report_page(places, results, title)
    write_text(page.text, out)
    if as_json:
        keys = {"name": "title", "kind": "kind", "state": "state", "missing": "missing"}
        results_data = [{key: getattr(chapter, name) for key, name in keys.items()} for chapter in page.chapters]
        print_json("report", {"file": str(out), "results": results_data})
        return
    print_message(f"wrote {out}")
    for chapter in page.chapters:
        for line in chapter.missing:
            print_message(f"warning: {chapter.title}: {line}")
