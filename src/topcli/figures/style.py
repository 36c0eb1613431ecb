"""Looks of pictures: the print style, colours and dashes of lines, symbols, labels, and legends that hide nothing."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from topcli.engine.columns import SYMBOLS
from topcli.schemes.display import COMPOSED, FAMILIES, display_name

if TYPE_CHECKING:
    from topcli.config.models import Experiment

STYLE = Path(__file__).parent / "print.mplstyle"
MARKERS = "os^Dv<>PXh"
"""Markers; those of schemes that figures often show together are different."""
DASHES = ("-", "--", "-.", (0, (6, 1, 1, 1, 1, 1)), ":", (0, (2, 1)))
"""Dashes of the first, second, ... line of a colour, where lines have markers too."""

_GREEK = frozenset("alpha beta gamma delta epsilon zeta eta theta iota kappa lambda mu nu xi".split())  # noqa: SIM905
_GREEK |= frozenset("pi rho sigma tau upsilon phi chi psi omega".split())  # noqa: SIM905


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


def plain_text(text: str) -> str:
    """Text that matplotlib shows as it is, without reading it as mathematics."""
    return text.replace("$", r"\$")


def component_symbol(name: str) -> str:
    """Mathtext of a component of the state: ``omega1``, ``a3`` or ``theta``; other words are upright."""
    letter = name.rstrip("0123456789")
    number = name[len(letter) :]
    symbol = rf"\{letter}" if letter in _GREEK else letter
    if letter not in _GREEK and len(letter) > 1:
        symbol = r"\mathrm{" + letter.replace("_", r"\_") + "}"
    return f"${symbol}_{{{number}}}$" if number else f"${symbol}$"


def column_label(experiment: Experiment, column: str) -> str:
    """Mathtext of a column of the run of ``experiment``: a component or an integral; its name for any other."""
    integrals = {each.name: each.tex for each in (*experiment.top.invariants(), *experiment.modified)}
    if column in experiment.top.components:
        return component_symbol(column)
    tex = SYMBOLS.get(column) or integrals.get(column)
    return f"${tex}$" if tex else plain_text(column)


def scheme_label(experiment: Experiment) -> str:
    """Display name of the scheme, with its options other than the defaults."""
    changed = experiment.options.model_dump(mode="json", exclude_defaults=True)
    options = ", ".join(f"{key}={value}" for key, value in changed.items())
    return display_name(experiment.scheme.name) + (f" ({options})" if options else "")


def labelled(axes: Any, x: str, y: str, title: str = "", **options: Any) -> None:
    """Write names beside the axes and a title above them on the left; ``options`` are those of ``axes.set``."""
    axes.set(xlabel=x, ylabel=y, **options)
    axes.set_title(title, loc="left")


def legend_above(axes: Any) -> None:
    """Put the legend above the axes on the right."""
    axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=4, borderaxespad=0.2)


def legend_below(canvas: Any, ncols: int, **options: Any) -> None:
    """Put one legend below all axes of a figure, with each label once."""
    entries: dict[str, Any] = {}
    for axes in canvas.axes:
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
            entries.setdefault(label, handle)
    look = {"fontsize": "small", "loc": "outside lower center", **options}
    canvas.legend(entries.values(), entries, ncols=ncols, **look)


def halo(text: Any, width: float) -> None:
    """Surround a text by white, so that it can be read over lines."""
    from matplotlib.patheffects import withStroke

    text.set_path_effects([withStroke(linewidth=width, foreground="white")])
