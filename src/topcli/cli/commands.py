"""All commands: the groups of the help and the place of the code of each, and what became of earlier commands.

This module imports nothing that takes time: the help of ``topcli`` reads it at every start.
"""

from __future__ import annotations

from topcli import STUDIES

STUDY = "study"
"""Place of a command that follows from a study."""

FIRST = ("compare", "order", "bench", "analyse")
"""Studies among the commands that most users need."""
GROUPS = {
    "Run and compare": {"run": "run.run", "sweep": "sweep.sweep", **dict.fromkeys(FIRST, STUDY)},
    "Studies": {name: STUDY for name in STUDIES if name not in FIRST},
    "Look at results": {
        "report": "results.report",
        "plot": "plot.plot",
        "animate": "results.animate",
        "table": "results.table",
        "verify": "results.verify",
    },
    "Reference": {
        "list": "listing.list_app",
        "show": "inspect.show",
        "cite": "listing.cite",
        "init": "inspect.init",
        "schema": "inspect.schema",
    },
}
"""Commands by the group in which the help lists them, in its order; ``module.function`` or ``module.group``."""

COMMANDS = {name: place for group in GROUPS.values() for name, place in group.items()}
"""Places of all commands."""

GONE = {
    "plot --configs": "figures draw packaged scenes; for other configs, use topcli run and topcli report",
    "plot --jobs": "figures are drawn one after the other",
    "plot --overlay": "topcli compare SCHEME --plot draws the reference in grey behind the motion",
    "plot --set": "figures draw packaged scenes; for other values, use topcli run and topcli report",
    "plot --style": "draw the data in the .parquet file beside the picture in a style of your own",
    **dict.fromkeys(
        (f"{study} --style" for study in ("analyse", "compare", "lyapunov", "order", "roundoff")),
        "draw the report in Python on axes of your own style: report.plot(ax)",
    ),
    **dict.fromkeys(
        (f"{study} {option}" for study in ("compare", "order", "roundoff") for option in ("--format", "--out")),
        "give --plot FILE a name ending in .png, .pdf or .svg, and --save FILE one ending in .json, .csv, .md or .tex",
    ),
    "claims --markdown": "use --save FILE.md",
    "order --duration": "use --set T=...",
    "order --top": "give --config CONFIG",
    "discover": "topcli integrability finds the integrals of a map",
    "doctor": "use topcli --version",
    "run --format": "use --set output.format=csv",
    "run --name": "use --set name=NAME",
    "run --resume": "run the same config again; it continues",
    "run --retry-failed": "use --force",
    "init --top": "copy a scene with --config SCENE, and edit it",
    "init --scheme": "copy a scene with --config SCENE, and edit it",
    "run --fail-fast": "give one config a call to stop at the first run that fails",
    "sweep --fail-fast": "failures are reported at once; Ctrl-C stops a sweep, and the same command continues it",
    "sweep --retry-failed": "a row that an error ended runs again with the same command; --force begins anew",
    "sweep --time-limit": "shorten the rows with N, T or output.every",
    "sweep --yes": "a sweep of any size runs without it",
}
"""Replacements of commands and options of earlier versions, for messages."""
