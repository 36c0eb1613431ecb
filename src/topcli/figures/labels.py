"""Names in pictures: symbols of columns, labels of axes, legends that hide nothing."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from topcli.engine.columns import SYMBOLS
from topcli.schemes.display import display_name

if TYPE_CHECKING:
    from topcli.config.models import Experiment

_GREEK = frozenset("alpha beta gamma delta epsilon zeta eta theta iota kappa lambda mu nu xi".split())  # noqa: SIM905
_GREEK |= frozenset("pi rho sigma tau upsilon phi chi psi omega".split())  # noqa: SIM905


def escaped(text: str) -> str:
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
    return f"${tex}$" if tex else escaped(column)


def scheme_label(experiment: Experiment) -> str:
    """Display name of the scheme, with its options other than the defaults."""
    changed = experiment.options.model_dump(mode="json", exclude_defaults=True)
    options = ", ".join(f"{key}={value}" for key, value in changed.items())
    return display_name(experiment.scheme.name) + (f" ({options})" if options else "")


def labelled(axes: Any, x: str, y: str, title: str = "", **options: Any) -> None:
    """Write names beside the axes and a title above them on the left; ``options`` are those of ``axes.set``."""
    axes.set(xlabel=x, ylabel=y, **options)
    axes.set_title(title, loc="left")


def legend_above(axes: Any, ncols: int = 4) -> None:
    """Put the legend above the axes on the right."""
    axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=ncols, borderaxespad=0.2)


def legend_below(canvas: Any, ncols: int, **options: Any) -> None:
    """Put one legend below all axes of a figure, with each label once."""
    entries: dict[str, Any] = {}
    for axes in canvas.axes:
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
            entries.setdefault(label, handle)
    look = {"fontsize": "small", "loc": "outside lower center", **options}
    canvas.legend(entries.values(), entries, ncols=ncols, **look)


def halo(text: Any, width: float = 2.5) -> None:
    """Surround a text by white, so that it can be read over lines."""
    from matplotlib.patheffects import withStroke

    text.set_path_effects([withStroke(linewidth=width, foreground="white")])
