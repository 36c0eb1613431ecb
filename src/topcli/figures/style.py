"""Looks of pictures: the print style, colours and dashes of lines."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from topcli.schemes.display import COMPOSED, FAMILIES, display_name

STYLE = Path(__file__).parent / "print.mplstyle"
MARKERS = "os^Dv<>PXh"
"""Markers; those of schemes that figures often show together are different."""
DASHES = ("-", "--", "-.", (0, (6, 1, 1, 1, 1, 1)), ":", (0, (2, 1)))
"""Dashes of the first, second, ... line of a colour, where lines have markers too."""


def looks(labels: Iterable[str], markers: bool = False) -> dict[str, dict[str, Any]]:
    """Look of each different label: that of a scheme is the same in all figures, any other has the next free one.

    Schemes are recognized by their names and their display names; related ones and compositions have one colour.
    Lines of one figure differ in colour or dashes, those with ``markers`` in colour, marker or dashes; without markers,
    the dashes follow the order of the labels.
    """
    import matplotlib as mpl

    cycle, n = list(mpl.rcParams["axes.prop_cycle"]), len(mpl.rcParams["axes.prop_cycle"])
    places_of_schemes: dict[str, tuple[int, int]] = {}
    for i, family in enumerate(FAMILIES):
        compositions = (f"{name}+{each}" for name in family for each in COMPOSED)
        for k, name in enumerate(dict.fromkeys((*family, *compositions))):
            places_of_schemes[name] = places_of_schemes[display_name(name)] = i % n, k
    different, free = list(dict.fromkeys(labels)), ((k % n, k // n) for k in itertools.count())
    places = {label: places_of_schemes[label] for label in different if label in places_of_schemes}
    for label in different:
        if label not in places_of_schemes:
            places[label] = next(place for place in free if place not in places.values())
    styles = {}
    for i, label in enumerate(different):
        colour, turn = places[label]
        styles[label] = {"color": cycle[colour]["color"], "linestyle": cycle[i % n].get("linestyle", "-")}
        if markers:
            marker = MARKERS[(colour + 3 * turn) % len(MARKERS)]
            styles[label] |= {"marker": marker, "linestyle": DASHES[turn % len(DASHES)]}
    return styles


@contextmanager
def styled(style: Mapping[str, Any] | None = None) -> Iterator[None]:
    """Context with the parameters of the print style, and with those of ``style`` in their place."""
    import matplotlib as mpl

    chosen: Any = dict(style or {})
    with mpl.rc_context(fname=STYLE), mpl.rc_context(chosen):
        yield
