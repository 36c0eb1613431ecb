"""Looks of pictures: the print style, colours and dashes of lines."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from topcli.schemes.display import FAMILIES, display_name

STYLE = Path(__file__).parent / "print.mplstyle"

Styles = Mapping[str, dict[str, Any]]
"""Line style of each label of a figure."""
REFERENCE = "reference"
"""Label of the line that others are compared with: broad, grey, and behind them."""


REFERENCE_LOOK: dict[str, Any] = {"color": "0.8", "linewidth": 3.5, "linestyle": "-", "zorder": 1.5}
MARKERS = "os^Dv<>PXh"
"""Markers; those of schemes that figures often show together are different."""
DASHES = ("-", "--", "-.", (0, (6, 1, 1, 1, 1, 1)), ":", (0, (2, 1)))
"""Dashes of the first, second, ... line of a colour, where lines have markers too."""


def looks(labels: Iterable[str], markers: bool = False) -> dict[str, dict[str, Any]]:
    """Look of each different label: that of a scheme is the same in all figures, any other has the next free one.

    Schemes are recognized by their names and their display names; related ones and compositions have one colour.
    Lines of one figure differ in colour and dashes, those with ``markers`` also in marker and dashes.
    """
    import matplotlib as mpl

    cycle = list(mpl.rcParams["axes.prop_cycle"])
    places: dict[str, tuple[int, int]] = {}
    free = ((i % len(cycle), i // len(cycle)) for i in itertools.count())
    own: dict[str, tuple[int, int]] = {}
    for i, family in enumerate(FAMILIES):
        for k, name in enumerate(family):
            own[name] = own[display_name(name)] = i % len(cycle), k
    different = list(dict.fromkeys(labels))
    for label in sorted(different, key=lambda label: label not in own):
        base = own.get(label.split("+")[0].strip()) if "+" in label else None
        turns = ((base[0], len(FAMILIES[base[0]]) + k) for k in itertools.count()) if base else free
        place = own.get(label) or next(turns)
        while place in places.values():
            place = next(turns)
        places[label] = place
    places = {label: places[label] for label in different}
    if markers:
        return {label: _marked(cycle[colour]["color"], colour, turn) for label, (colour, turn) in places.items()}
    dashes: dict[str, int] = {}
    for label, (colour, turn) in places.items():
        wanted = [(colour + turn + k) % len(cycle) for k in range(len(cycle))]
        dashes[label] = next((at for at in wanted if at not in dashes.values()), wanted[0])
    styles = {label: cycle[at].get("linestyle", "-") for label, at in dashes.items()}
    return {label: {**cycle[colour], "linestyle": styles[label]} for label, (colour, _) in places.items()}


def _marked(shade: Any, colour: int, turn: int) -> dict[str, Any]:
    """Look of a line with markers, number ``turn`` of its colour."""
    marker = MARKERS[(colour + 3 * turn) % len(MARKERS)]
    return {"color": shade, "marker": marker, "linestyle": DASHES[turn % len(DASHES)]}


@contextmanager
def styled(style: Mapping[str, Any] | None = None) -> Iterator[None]:
    """Context with the parameters of the print style, and with those of ``style`` in their place."""
    import matplotlib as mpl

    chosen: Any = dict(style or {})
    with mpl.rc_context(fname=STYLE), mpl.rc_context(chosen):
        yield
