"""Looks of pictures: the print style, colours and dashes of lines, and style files of users."""

from __future__ import annotations

import itertools
import warnings
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from topcli.errors import UsageError, clipped, nearest, quoted
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

    with warnings.catch_warnings(action="ignore"):  # of matplotlib 3.11, which moves it
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
