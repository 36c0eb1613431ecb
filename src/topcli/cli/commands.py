"""All commands: groups of the help, and for each the place of its code, two examples and its own exit codes.

This module imports nothing that takes time: the help of ``topcli`` reads it at every start.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

STUDY = "study"
"""Place of a command that follows from a study."""


class Entry(NamedTuple):
    """Declaration of a command.

    Attributes
    ----------
    place : str
        ``module.function`` or ``module.group`` in this package, or ``STUDY``.
    examples : tuple of str
        Two command lines, which the help shows at its end.
    exits : mapping of int to str
        Meaning of each exit code besides those that every command has: 0, 2, 70 and 130.
    """

    place: str
    examples: tuple[str, str]
    exits: Mapping[int, str] = MappingProxyType({})


FIRST_EXAMPLES = (
    "topcli run kowalevski_hybrid",
    "topcli compare hk hybrid rk4 --config kowalevski_generic_hk",
)
"""Examples of ``topcli --help``."""

GROUPS: dict[str, dict[str, Entry]] = {
    "Run and compare": {
        "run": Entry(
            "run.run",
            (
                "topcli run kowalevski_hybrid",
                "topcli run experiment.yaml --set h=0.01 --set name=coarse",
            ),
            {1: "a run failed, or its state left its energy surface", 3: "some of several runs failed"},
        ),
        "compare": Entry(
            STUDY,
            (
                "topcli compare hk hybrid rk4 --config kowalevski_generic_hk",
                "topcli compare hk hk:h=0.02 --set h=0.01 --set T=40 --plot",
            ),
            {1: "a run failed", 3: "the code of some schemes raised an exception"},
        ),
        "order": Entry(
            STUDY,
            (
                "topcli order hk rk4",
                "topcli order hk --config euler_hk --h 0.1 --h 0.05 --h 0.025 --plot",
            ),
            {
                1: "the order of a scheme could not be measured",
                3: "the code of some schemes raised an exception",
                4: "a scheme lacks its declared order or does not conserve a declared invariant",
            },
        ),
        "sweep": Entry(
            "sweep.sweep",
            (
                "topcli sweep heavy_drift --dry-run",
                "topcli sweep kowalevski_errors --set base.T=5 --set name=short",
            ),
            {1: "all rows of the sweep failed", 3: "some rows failed"},
        ),
        "bench": Entry(
            "bench.bench",
            (
                "topcli bench hk hybrid --scene kowalevski-generic --against none",
                "topcli bench --config kowalevski_torus --set T=20 --points",
            ),
            {3: "a peer or a scheme failed"},
        ),
        "analyse": Entry(
            STUDY,
            (
                "topcli analyse other.csv --config kowalevski_hk",
                "topcli analyse other.csv --config euler_hk --rename t=time",
            ),
        ),
    },
    "Studies": {
        "roundoff": Entry(
            STUDY,
            ("topcli roundoff hk", "topcli roundoff hybrid --steps 1e8 --copies 16 --plot"),
            {1: "a run failed", 4: "a limit given by --max-exponent or --max-drift is exceeded"},
        ),
        "stress": Entry(
            STUDY,
            ("topcli stress hk", "topcli stress hk hybrid --case homoclinic-1e-6 --case pole"),
            {3: "the code of some schemes raised an exception", 4: "a scheme does not behave as it declares"},
        ),
        "check": Entry(
            STUDY,
            ("topcli check --scheme hk --top euler", "topcli check mine.py --save mine.json"),
            {1: "a check accepted its control, so it decided nothing", 4: "a scheme or top is not as declared"},
        ),
        "claims": Entry(
            STUDY,
            ("topcli claims --fast", "topcli claims hybrid-k-sq hybrid-reversible"),
            {1: "a run failed", 4: "the verdict on a claim differs from the recorded one"},
        ),
        "lax": Entry(
            STUDY,
            ("topcli lax kowalevski hk backlund", "topcli lax euler --config euler_hk --set T=20"),
            {1: "a run failed"},
        ),
        "integrability": Entry(
            STUDY,
            ("topcli integrability euler hk", "topcli integrability kowalevski hk --set h=0.1"),
        ),
        "lyapunov": Entry(
            STUDY,
            (
                "topcli lyapunov heavy_chaotic --plot",
                "topcli lyapunov kowalevski_hk --spectrum --set T=100",
            ),
            {1: "the orbit ended early, because a step failed"},
        ),
        "frequencies": Entry(
            STUDY,
            (
                "topcli frequencies kowalevski_torus",
                "topcli frequencies kowalevski_torus --component gamma3 --set h=0.005",
            ),
            {1: "the run failed"},
        ),
    },
    "Look at results": {
        "report": Entry(
            "results.report",
            (
                "topcli report results/kowalevski_hybrid --out hybrid.html",
                "topcli report kowalevski_hk kowalevski_hybrid --out both.html",
            ),
        ),
        "plot": Entry(
            "plot.plot",
            (
                "topcli plot fig4 --format svg",
                "topcli plot sweep results/heavy_drift --x scheme --y drift.energy",
            ),
            {1: "the figure could not be drawn", 3: "some figures could not be drawn"},
        ),
        "animate": Entry(
            "results.animate",
            (
                "topcli animate results/euler_attitude --out euler.gif",
                "topcli animate results/lagrange_cusps --out cusps.mp4 --seconds 20",
            ),
        ),
        "table": Entry(
            "results.table",
            (
                "topcli table kowalevski_errors --rows scheme --columns h --value max_error",
                "topcli table heavy_drift --rows scheme --value drift.energy --format latex",
            ),
        ),
        "verify": Entry(
            "results.verify",
            ("topcli verify results/kowalevski_hybrid", "topcli verify heavy_drift --json"),
            {1: "a file is damaged"},
        ),
    },
    "Reference": {
        "list": Entry("listing.list_app", ("topcli list schemes --top euler", "topcli list runs")),
        "show": Entry("inspect.show", ("topcli show hk", "topcli show kowalevski_hk --motion")),
        "cite": Entry("listing.cite", ("topcli cite", "topcli cite hk kowalevski")),
        "init": Entry("inspect.init", ("topcli init", "topcli init heavy.toml --top heavy --scheme hk")),
        "schema": Entry("inspect.schema", ("topcli schema", "topcli schema > topcli.schema.json")),
    },
}
"""Commands by the group in which the help lists them, in its order."""

COMMANDS = {name: entry for group in GROUPS.values() for name, entry in group.items()}
"""All commands by name."""

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
    "discover": "topcli integrability finds the integrals of a map; for an orbit, see docs/integrability.md",
    "doctor": "use topcli --version",
    "run --format": "use --set output.format=csv",
    "run --name": "use --set name=NAME",
    "run --fail-fast": "give one config a call to stop at the first run that fails",
    "sweep --fail-fast": "failures are reported at once; Ctrl-C stops a sweep, and the same command continues it",
    "sweep --time-limit": "shorten the rows with N, T or output.every",
    "sweep --yes": "a sweep of any size runs without it",
}
"""What to use instead of commands and options of earlier versions."""

LISTS = {
    "tops": ("topcli list tops", "topcli list tops --json"),
    "schemes": ("topcli list schemes", "topcli list schemes --top kowalevski"),
    "compositions": ("topcli list compositions", "topcli list compositions --json"),
    "scenes": ("topcli list scenes", "topcli list scenes --top lagrange"),
    "sweeps": ("topcli list sweeps", "topcli list sweeps --json"),
    "cases": ("topcli list cases", "topcli list cases --top euler"),
    "measures": ("topcli list measures", "topcli list measures --top heavy"),
    "figures": ("topcli list figures", "topcli list figures --plugin mine.py"),
    "runs": ("topcli list runs", "topcli list runs --json"),
}
"""Examples of each command of ``topcli list``."""


def examples_of(path: str) -> tuple[str, str]:
    """Two examples of a command by its words after ``topcli``, such as ``"list tops"``; empty for all commands."""
    first, _, rest = path.partition(" ")
    if rest:
        return LISTS[rest]
    return COMMANDS[first].examples if first else FIRST_EXAMPLES
