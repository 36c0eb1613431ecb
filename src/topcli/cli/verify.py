"""``topcli verify``: compare the files of runs with their checksums."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from topcli.cli.options import Json, Out
from topcli.cli.output import emit, print_json, print_message


def verify(
    runs: Annotated[
        list[str], typer.Argument(metavar="RUN...", help="Folders of runs or sweeps, names in --out, or JSON files.")
    ],
    out: Out = Path("results"),
    as_json: Json = False,
) -> None:
    """Verify stored results by their checksums.

    For an unfinished run, verify the checkpoint and the rows that it can be continued from; for an unfinished sweep,
    its journal. Exits with status 0 if all files are intact, with 1 if a file is damaged.
    """
    from topcli.studies.checks import check_all

    checked = [one for run in runs for one in check_all(run, out)]
    if as_json:
        print_json("verify", {"runs": [one.data() for one in checked]})
    for one in checked:
        for file in one.files:
            if file.damaged:
                print_message(f"error: {one.folder / file.name}: damaged: {file.reason}")
        if not (as_json or one.damaged):
            kind = "finished" if one.finished else "unfinished"
            notes = "".join(f"; {file.name}: {file.reason}" for file in one.files if file.reason)
            emit(f"{one.folder}: {kind}, {len(one.files)} files intact{notes}")
    if any(one.damaged for one in checked):
        raise typer.Exit(1)
