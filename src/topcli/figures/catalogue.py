"""The figures that topcli can draw; those of the paper come first."""

from __future__ import annotations

from topcli.errors import UnknownNameError, nearest, quoted
from topcli.figures import diagram, paper, schemes, space  # noqa: F401 (they register their figures)
from topcli.figures.figure import FIGURES, Figure, figure
from topcli.plugins import require_plugin

__all__ = ["FIGURES", "figure", "find_figure"]
for name in [name for name in FIGURES if not name.startswith("fig")]:
    FIGURES[name] = FIGURES.pop(name)  # after those of the paper


def find_figure(name: str) -> Figure:
    """Return the figure called ``name``.

    Raises UnknownNameError with the nearest names, and SchemeCodeError for one whose plugin has failed.
    """
    key = name.lower()
    if key in FIGURES:
        return FIGURES[key]
    failures = require_plugin(key, "figure")
    if key in FIGURES:  # of a plugin
        return FIGURES[key]
    raise UnknownNameError(f"unknown figure {quoted(name)}; {nearest(name, FIGURES)}", *failures)
