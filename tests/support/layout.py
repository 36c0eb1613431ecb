"""Faults of a figure that a reader would see: text that is too small, leaves the page, or covers other text."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any
from unittest.mock import patch

from matplotlib.cbook import is_math_text
from matplotlib.figure import Figure
from matplotlib.mathtext import MathTextParser
from matplotlib.text import Text
from matplotlib.transforms import Bbox

from topcli.figures.style import styled

SMALLEST = 6.0
"""Points at printed size, of exponents and indices too."""
WIDEST, TALLEST = 7.0, 9.5
"""Inches that a page of print has for a figure."""
TOUCH = 1.0
"""Points by which the boxes of two texts may overlap: a box is higher than its letters."""


@contextmanager
def _recorded(found: dict[Text, Bbox]) -> Iterator[None]:
    """Collect the texts that are drawn, with their boxes: not the labels of ticks out of sight, for example."""
    draw = Text.draw

    def recording(text: Text, renderer: Any, *arguments: Any, **options: Any) -> None:
        if text.get_visible() and text.get_text().strip():
            found[text] = Text.get_window_extent(text, renderer)  # a text in space has its place only while it is drawn
        draw(text, renderer, *arguments, **options)

    with patch.object(Text, "draw", recording):
        yield


def drawn_texts(figure: Figure) -> dict[Text, Bbox]:
    """Texts of a figure as it is printed, with their boxes; the figure is laid out afterwards."""
    found: dict[Text, Bbox] = {}
    with styled(), _recorded(found):
        figure.canvas.draw()
    return found


def smallest_size(text: Text) -> float:
    """Size in points of the smallest letter of a text, in its exponents and indices too."""
    if not is_math_text(text.get_text()):
        return float(text.get_fontsize())
    with styled():
        parsed = MathTextParser("path").parse(text.get_text(), 72, text.get_fontproperties())
    return min(float(glyph[1]) for glyph in parsed.glyphs)


def _overlap(one: Bbox, other: Bbox) -> float:
    """Smaller side of the common part of two boxes in pixels; negative if they are apart."""
    wide = min(one.x1, other.x1) - max(one.x0, other.x0)
    high = min(one.y1, other.y1) - max(one.y0, other.y0)
    return min(wide, high)


def layout_faults(figure: Figure) -> list[str]:
    """A line for each fault of the layout, with its size in points."""
    boxes = list(drawn_texts(figure).items())
    points = 72.0 / figure.dpi
    renderer = figure.canvas.get_renderer()  # type: ignore[attr-defined]
    faults = []
    width, height = figure.get_size_inches()
    if width > WIDEST or height > TALLEST:
        faults.append(f"a figure of {width:g} x {height:g} inches")
    for text, box in boxes:
        name = repr(text.get_text())
        size = smallest_size(text)
        if size < SMALLEST - 1e-9:
            faults.append(f"{name} is small: {size:.1f} points")
        outside = max(-box.x0, -box.y0, box.x1 - figure.bbox.x1, box.y1 - figure.bbox.y1) * points
        if outside > 0.5:
            faults.append(f"{name} leaves the page: {outside:.1f} points")
    for i, (text, box) in enumerate(boxes):
        for other, its_box in boxes[:i]:
            if (common := _overlap(box, its_box) * points) > TOUCH:
                faults.append(f"{other.get_text()!r} and {text.get_text()!r} overlap: {common:.1f} points")
    legends = [*figure.legends, *(one for axes in figure.axes if (one := axes.get_legend()))]
    for legend in legends:
        own, frame = legend.findobj(Text), legend.get_window_extent(renderer)
        for text, box in boxes:
            if text not in own and (common := _overlap(box, frame) * points) > TOUCH:
                faults.append(f"a legend covers {text.get_text()!r}: {common:.1f} points")
    return faults
