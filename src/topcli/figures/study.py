"""Drawing of results: on axes of the user, or as a picture in the print style."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import nullcontext
from typing import TYPE_CHECKING, Any

from topcli.figures.figure import Drawing, picture_of
from topcli.figures.style import looks, styled

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SIZE = (6.4, 3.6)
"""Width and height in inches."""


def on_axes(draw: Drawing, ax: Axes | None = None) -> Axes:
    """Draw into ``ax`` in the style of its owner, or into new axes in the print style."""
    with styled() if ax is None else nullcontext():
        if ax is None:
            from matplotlib import pyplot

            ax = pyplot.figure(figsize=SIZE).add_subplot()
        draw(ax)
    return ax


def drawing_of(draw: Callable[..., None]) -> Drawing:
    """Drawing of a report with the styles of lines; lines with labels get a legend beside the axes."""

    def complete(axes: Any) -> None:
        draw(axes, looks)
        if axes.get_legend() is None and len(axes.get_legend_handles_labels()[1]) > 1:
            axes.legend(loc="upper left", bbox_to_anchor=(1.01, 1.02), fontsize="small")

    return complete


def picture(draw: Drawing, form: str = "svg", size: tuple[float, float] = SIZE) -> bytes:
    """Picture of one pair of axes in a format, "png", "pdf" or "svg"."""
    return picture_of(lambda canvas, _: draw(canvas.add_subplot()), {}, size, form)
