"""Faults of a call of the command and of a run folder."""

from __future__ import annotations

import json
import re
import signal
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from attack.command import LIMIT, Said
from topcli.errors import ExitCode, TopcliError
from topcli.store.series import read_series

LONGEST = 1000
"""Characters that a message may have."""
_CONTROL = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u202a-\u202e\u2066-\u2069]")
_BEGINS = re.compile(r"^(?=(?:error|warning|usage|interrupted)\b)", re.IGNORECASE | re.MULTILINE)
_TELLTALES = ("Traceback (most recent call last)", "this is a bug", "Fatal Python error")


@dataclass(frozen=True)
class Finding:
    """Something that must not be: its kind, the case that shows it, and what was seen."""

    kind: str
    case: str
    text: str

    def __str__(self) -> str:
        text = "".join(letter if letter.isprintable() else repr(letter)[1:-1] for letter in self.text)
        return f"{self.kind}: {self.case}: {text if len(text) <= 300 else text[:297] + '...'}"


Faults = list[tuple[str, str]]
"""Kinds of faults, and what was seen."""


def _last_line(text: str) -> str:
    lines = [line for line in text.splitlines() if line.strip() and "this is a bug" not in line]
    return lines[-1].strip() if lines else ""


def judged(said: Said) -> Faults:
    """Everything wrong with one call that shows without knowing what it was meant to do."""
    call, found = "topcli " + " ".join(said.argv), []
    if said.code is None:
        found.append(("hang", f"{call}: still running after {LIMIT:g} s and SIGTERM"))
    elif said.code < 0:
        stack = [line.strip() for line in said.err.splitlines() if line.startswith("  File")][:1]
        found.append(("signal", f"{call}: {signal.Signals(-said.code).name} {' '.join(stack)}"))
    elif said.code not in list(ExitCode):
        found.append(("exit code", f"{call}: exited with {said.code}: {_last_line(said.err)}"))
    if said.slow:
        found.append(("slow", f"{call}: not ended after {LIMIT:g} s, but by SIGTERM"))
    everything = said.out + said.err
    if said.code is not None and said.code < 0:
        pass  # what is printed then is the system's
    elif said.code == ExitCode.BUG or any(words in everything for words in _TELLTALES):
        found.append(("traceback", f"{call}: {_last_line(said.err)}"))
    else:
        messages = [*_BEGINS.split(said.err), *([] if _is_data(said) else said.out.splitlines())]
        longest = max(messages, key=len, default="")
        if len(longest) > LONGEST:
            found.append(("long message", f"{call}: {len(longest)} characters: {longest[:80]}"))
    for stream, text in (("stdout", said.out), ("stderr", said.err)):
        if bad := _CONTROL.search(text):
            begin = max(0, bad.start() - 40)
            near = text[begin : bad.end() + 10]
            found.append(("control character", f"{call}: U+{ord(bad[0]):04X} on {stream}: {near}"))
    found += [("touched", f"{call}: {path}") for path in said.touched[:3]]
    return found


def _is_data(said: Said) -> bool:
    """True for output whose lines may be long: JSON, and the YAML of a config."""
    return "--json" in said.argv or said.argv[0] in ("show", "schema")


@dataclass(frozen=True)
class Content:
    """A run folder apart from times: the bytes of its files, the rows of its series, its report and its config."""

    files: dict[str, bytes]
    rows: dict[str, np.ndarray]
    report: dict[str, Any]
    manifest: dict[str, Any]

    @property
    def config(self) -> bytes:
        """The config as a text."""
        return self.files["config.yaml"]


def content(folder: Path) -> Content:
    """Content of a run folder. Raises ValueError if it cannot be read."""
    try:
        files = {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}
        manifest = json.loads(files["manifest.json"])
        report = json.loads(files["report.json"])
        rows = read_series(folder / manifest["series"])
        del report["seconds"]
        kept = {key: manifest.get(key) for key in ("digest", "code", "outcome", "message", "step", "config")}
        files["config.yaml"].decode()
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError, TopcliError) as error:
        raise ValueError(f"{folder.name} cannot be read: {type(error).__name__} {error}") from None
    return Content(files, rows, report, kept)


def rows_apart(expected: dict[str, np.ndarray], found: dict[str, np.ndarray]) -> str:
    """First difference of two series in a bit; empty if there is none."""
    if list(expected) != list(found):
        return f"columns {list(found)}, not {list(expected)}"
    for name, values in expected.items():
        if len(values) != len(found[name]):
            return f"{len(found[name])} rows, not {len(values)}"
        same = (values == found[name]) | ((values != values) & (found[name] != found[name]))
        if values.dtype.kind == "f":
            same &= np.signbit(values) == np.signbit(found[name])
        if not same.all():
            row = int(np.argmin(same))
            return f"{int((~same).sum())} rows differ, first {name}[{row}]: {found[name][row]} and not {values[row]}"
    return ""


def wrong_content(expected: Content, folder: Path) -> str:
    """Difference of a run folder from that of ``expected``, apart from times; empty if there is none."""
    try:
        found = content(folder)
    except ValueError as error:
        return str(error)
    if apart := rows_apart(expected.rows, found.rows):
        return apart
    for name in ("report", "manifest", "config"):
        if getattr(found, name) != getattr(expected, name):
            return f"another {name}"
    return ""
