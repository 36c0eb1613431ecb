"""Drawing of results: on axes of the user, or as a picture in the print style."""

from __future__ import annotations

import io
from collections.abc import Callable
from contextlib import nullcontext
from typing import TYPE_CHECKING, Any

from topcli.figures.figure import Drawing, canvas_of, save
from topcli.figures.style import looks, styled

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SIZE = (6.4, 3.6)
"""Width and height in inches."""


def on_axes(draw: Drawing, ax: Axes | None = None, projection: str | None = None) -> Axes:
    """Draw into ``ax`` in the style of its owner, or into new axes in the print style.

    A three-dimensional picture replaces two-dimensional axes by others at their place.
    """
    with styled() if ax is None else nullcontext():
        if ax is None:
            from matplotlib import pyplot

            ax = pyplot.figure(figsize=SIZE).add_subplot(projection=projection)
        elif projection and ax.name != projection:
            figure, place, box = ax.figure, ax.get_subplotspec(), ax.get_position().bounds
            ax.remove()
            of: dict[str, Any] = {"projection": projection}
            ax = figure.add_subplot(place, **of) if place else figure.add_axes(box, **of)
        draw(ax)
    return ax


def drawing_of(draw: Callable[..., None]) -> Drawing:
    """Drawing of a report with the styles of lines; lines with labels get a legend beside the axes."""

    def complete(axes: Any) -> None:
        draw(axes, looks)
        if axes.get_legend() is None and len(axes.get_legend_handles_labels()[1]) > 1:
            axes.legend(loc="upper left", bbox_to_anchor=(1.01, 1.02), fontsize="small")

    return complete


def picture(draw: Drawing, form: str = "svg", size: tuple[float, float] = SIZE, projection: str | None = None) -> bytes:
    """Picture of one pair of axes in a format, "png", "pdf" or "svg"."""
    canvas = canvas_of(lambda canvas, _: draw(canvas.add_subplot(projection=projection)), {}, size)
    sink = io.BytesIO()
    save(canvas, sink, form)
    return sink.getvalue()
