"""``topcli cite``: print BibTeX entries."""

from __future__ import annotations

from typing import Annotated

import typer

from topcli.cli.options import Json, SchemeFiles, complete_scheme, complete_top, load_scheme_files
from topcli.cli.output import emit_text, print_json


def complete_cited(incomplete: str) -> list[str]:
    """Names of tops and schemes that begin with ``incomplete``."""
    return [*complete_top(incomplete), *complete_scheme(incomplete)]


def cite(
    names: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="SCHEME|TOP",
            help="Schemes, compositions and tops; by default topcli and the paper.",
            autocompletion=complete_cited,
        ),
    ] = None,
    as_json: Json = False,
    scheme_files: SchemeFiles = None,
) -> None:
    """Print the BibTeX of a scheme, a top, or topcli itself."""
    from topcli.studies.citations import own_works, works_of

    load_scheme_files(scheme_files)
    found = {entry.key: entry for name in names or () for entry in works_of(name)} if names else None
    entries = own_works() if found is None else list(found.values())
    if as_json:
        print_json("cite", {"entries": [{"key": entry.key, "bibtex": entry.bibtex} for entry in entries]})
    else:
        emit_text("\n\n".join(entry.bibtex for entry in entries))
