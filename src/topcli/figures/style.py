"""Style files of matplotlib, checked line by line."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

from topcli.errors import UsageError, clipped, nearest, quoted

FONTS = ("font.family", "font.serif", "font.sans-serif", "font.monospace", "font.cursive", "font.fantasy")
"""Parameters that are lists of fonts; those that are missing would be replaced without a word in the picture."""


def read_style(path: Path) -> dict[str, Any]:
    """Return the parameters of a style file (``key: value`` lines) by their names.

    Raises UsageError with file and line for what matplotlib refuses, and for parameters that are not part of a style,
    such as ``backend``.
    """
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except OSError as error:
        raise UsageError(f"--style {path}: {error.strerror or error}") from error
    except UnicodeDecodeError as error:
        raise UsageError(f"--style {path}: not a text file in UTF-8") from error
    found: dict[str, Any] = {}
    for number, line in enumerate(lines, 1):
        text = _without_comment(line).strip()
        if text:
            key, value = _parameter(text, f"--style {path}:{number}")
            found[key] = value
    return found


def _installed(key: str, names: list[str], where: str) -> list[str]:
    """The fonts of a list that this machine has. Raises UsageError if there are none."""
    from matplotlib.font_manager import get_font_names

    known = {*get_font_names(), *(font.partition(".")[2] for font in FONTS)}
    found = [name for name in names if name in known]
    if not found:
        hint = nearest(names[0], get_font_names())
        hint = hint if hint.startswith("did you mean") else "see matplotlib.font_manager.get_font_names()"
        raise UsageError(f"{where}: {key}: no font {quoted(', '.join(names))} on this machine; {hint}")
    return found


def _without_comment(line: str) -> str:
    """The line up to a ``#`` outside of double quotes, as matplotlib reads it."""
    quotes = False
    for at, letter in enumerate(line):
        if letter == '"':
            quotes = not quotes
        elif letter == "#" and not quotes:
            return line[:at]
    return line


def _parameter(text: str, where: str) -> tuple[str, Any]:
    """Name and checked value of a line. Raises UsageError."""
    import matplotlib as mpl
    from matplotlib.style.core import STYLE_BLACKLIST

    key, colon, value = (part.strip() for part in text.partition(":"))
    if not colon:
        raise UsageError(f"{where}: {quoted(text)} is not a line KEY: VALUE, as in font.size: 9")
    if key in STYLE_BLACKLIST:
        raise UsageError(f"{where}: {key} is not part of a style; remove the line")
    if key not in mpl.rcParams:
        hint = nearest(key, mpl.rcParams)
        hint = hint if hint.startswith("did you mean") else "see matplotlib.rcParams for all"
        raise UsageError(f"{where}: matplotlib has no parameter {quoted(key)}; {hint}")
    value = value[1:-1] if value[:1] == value[-1:] == '"' and len(value) > 1 else value
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            parameters: Any = mpl.RcParams({key: value})
            checked = parameters[key]
    except (ValueError, TypeError, Warning) as error:
        reason = " ".join(str(error).split()).removeprefix(f"Key {key}: ")
        raise UsageError(f"{where}: {key}: {clipped(reason)}") from error
    if key == "axes.prop_cycle" and "color" not in checked.keys:
        raise UsageError(f"{where}: {key}: a cycle without colours; add cycler('color', [...])")
    return key, _installed(key, checked, where) if key in FONTS else checked
