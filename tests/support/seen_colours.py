"""Colours as readers without green receptors, and grey print, show them."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.colors import to_hex, to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

DEUTERANOPIA = np.array(
    [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]]
)
"""Machado, Oliveira and Fernandes, IEEE Trans. Vis. Comput. Graph. 15 (2009) 1291, full severity, in linear RGB."""
TO_XYZ = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
WHITE = TO_XYZ.sum(axis=1)


def _linear(colour: Any) -> np.ndarray:
    rgb = np.array(to_rgb(colour))
    return np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)


def _lab(linear: np.ndarray) -> np.ndarray:
    """CIELAB of linear sRGB."""
    ratio = TO_XYZ @ np.clip(linear, 0.0, 1.0) / WHITE
    x, y, z = np.where(ratio > 0.008856, np.cbrt(ratio), 7.787 * ratio + 16.0 / 116.0)
    return np.array([116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)])


def difference(one: Any, other: Any, *, deuteranopia: bool) -> float:
    """CIE76 difference of two colours; 2.3 is just noticeable side by side."""
    view = DEUTERANOPIA if deuteranopia else np.eye(3)
    return float(np.linalg.norm(_lab(view @ _linear(one)) - _lab(view @ _linear(other))))


def lightness(colour: Any) -> float:
    """CIE lightness, 0 to 100, which is what grey print keeps."""
    return float(_lab(_linear(colour))[0])


def pattern(line: Line2D) -> tuple[Any, ...]:
    """All that tells a line from others but its colour."""
    filled = to_hex(line.get_markerfacecolor()) != "#ffffff" if line.get_markerfacecolor() != "none" else False
    width = line.get_linewidth() > 2.5
    return line._unscaled_dash_pattern, line.get_linestyle(), line.get_marker(), filled, width  # type: ignore[attr-defined]


def lines_alike(figure: Figure) -> list[str]:
    """Labels of lines of one panel that differ in colour alone, or in width or lightness alone."""
    found = []
    for axes in figure.axes:
        handles, labels = axes.get_legend_handles_labels()
        seen: dict[tuple[Any, ...], tuple[str, Line2D]] = {}
        for handle, label in zip(handles, labels, strict=True):
            if isinstance(handle, Line2D):
                first, line = seen.setdefault(pattern(handle), (label, handle))
                if first != label and not thin_and_pale(handle, line):
                    found.append(f"{first} and {label}")
    return found


def thin_and_pale(one: Line2D, other: Line2D) -> bool:
    """True if one of two lines is clearly thinner and paler: the far part of a curve in space."""
    thin, broad = sorted((one, other), key=lambda line: line.get_linewidth())
    paler = lightness(thin.get_color()) - lightness(broad.get_color()) > 15.0
    return paler and thin.get_linewidth() < 0.85 * broad.get_linewidth()
