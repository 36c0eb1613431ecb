"""Pictures as SVG elements of a page: colours follow its scheme, and names of parts are unique within it."""

from __future__ import annotations

import io
import re
from collections.abc import Mapping
from html import escape
from typing import TYPE_CHECKING

import numpy as np

from topcli.errors import printable
from topcli.figures.picture import STYLE, Drawable, Grid, draw

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SIZE = (4.8, 2.8)
"""Inches of a picture with one panel, whose text is still readable at the width of a phone."""

COLOURS = {
    "#000000": "currentColor",
    "#ffffff": "var(--paper)",
    "#e0e0e0": "var(--grid)",
    "#0072b2": "var(--line1)",
    "#d55e00": "var(--line2)",
    "#009e73": "var(--line3)",
    "#cc79a7": "var(--line4)",
    "#56b4e9": "var(--line5)",
    "#e69f00": "var(--line6)",
}
"""Colours of ``print.mplstyle``, and those of the page that replace them."""

_HEAD = re.compile(r"<svg\b[^>]*>")
_SIZE = re.compile(r'(width|height)="([0-9.]+)pt"')
_UNUSED = re.compile(r"<metadata>.*?</metadata>|<style\b.*?</style>|<!--.*?-->", re.DOTALL)
_NAME = re.compile(r'(\bid="|xlink:href="#|href="#|url\(#)')
_SPACES = 'xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink"'
_NO_METADATA = {"Date": None, "Creator": None, "Format": None, "Type": None}


def svg_of(panel: Drawable, data: Mapping[str, np.ndarray], name: str, label: str, layout: Grid | None = None) -> str:
    """Draw one panel over the columns of ``data`` as an SVG element.

    ``name`` is unique within the page, ``label`` describes the picture to those who do not see it.
    """
    return element(draw((panel,), data, layout or Grid(figsize=SIZE)), name, label)


def element(figure: Figure, name: str, label: str) -> str:
    """SVG element of a matplotlib figure on a transparent ground."""
    import matplotlib as mpl

    figure.patch.set_visible(False)
    for axes in figure.axes:
        axes.patch.set_visible(False)
    sink = io.StringIO()
    with mpl.rc_context(fname=STYLE), mpl.rc_context({"svg.fonttype": "path", "svg.hashsalt": name}):
        figure.savefig(sink, format="svg", metadata=_NO_METADATA)
    text = _UNUSED.sub("", sink.getvalue())
    head = _HEAD.search(text)
    if head is None:
        raise ValueError("matplotlib wrote no SVG element")
    body = text[head.end() :].strip()
    body = _NAME.sub(lambda found: f"{found[1]}{name}-", body)
    for colour, own in COLOURS.items():
        body = body.replace(colour, own)
    width, height = (float(size) for _, size in _SIZE.findall(head[0])[:2])
    size = f'viewBox="0 0 {width:g} {height:g}" width="{width / 0.75:.0f}" height="{height / 0.75:.0f}"'
    about = f'role="img" aria-label="{escape(printable(label), quote=True)}" fill="currentColor"'
    return f"<svg {size} {about} {_SPACES}>{body}"
