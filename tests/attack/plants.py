"""Plants faults into topcli, one of each kind, and prints which kinds the judge of the attack sees: ``{plant: kinds}``.

``python plants.py FOLDER``, in a process of its own because it forks and puts another ``main`` into place.
"""

from __future__ import annotations

import ctypes
import json
import os
import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path

import topcli.__main__
from attack.command import call
from attack.judge import judged


def _segfault() -> None:
    ctypes.string_at(0)


def _heed() -> None:
    signal.signal(signal.SIGTERM, lambda number, frame: sys.exit(130))
    time.sleep(60)


def _fail() -> None:
    raise ZeroDivisionError("planted")


def _print(text: str, stream: int = 2) -> Callable[[], None]:
    return lambda: os.write(stream, text.encode()) and None


def _leave(code: int) -> Callable[[], None]:
    return lambda: sys.exit(code)


def main() -> None:
    """Call each plant in the place of the command."""
    folder = Path(sys.argv[1])
    (folder / "out").mkdir()
    outside = folder / "outside"
    real = topcli.__main__.main

    def with_app(work: Callable[[], None]) -> Callable[[], None]:
        """The real ``main`` around an application that does ``work``."""

        def called() -> None:
            import topcli.cli.app

            topcli.cli.app.app = lambda prog_name: work()  # pyright: ignore[reportAttributeAccessIssue]
            real()

        return called

    plants: dict[str, Callable[[], None]] = {
        "nothing": lambda: None,
        "write in out": lambda: (folder / "out" / "x").write_text("x") and None,
        "tab and letters": _print("a\tb ä 漢\n", 1),
        "message of 1000": _print("error: " + "x" * 993),
        "two messages": _print(("error: " + "x" * 900 + "\n") * 2),
        "codes": _leave(130),
        "segfault": _segfault,
        "exception": with_app(_fail),
        "unknown code": _leave(5),
        "code of a bug": _leave(70),
        "hang": lambda: time.sleep(60),
        "slow": _heed,
        "message of 1001": _print("error: " + "x" * 994),
        "message of many lines": _print("error: a\n" + "x\n" * 500),
        "escape": _print("\x1b[31mred", 1),
        "carriage return": _print("a\rb"),
        "C1": _print("\x9b2J"),
        "bidi": _print("\u202etxt", 1),
        "write outside": lambda: outside.write_text("x") and None,
        "remove outside": lambda: outside.unlink(missing_ok=True),
        "rename to outside": lambda: os.rename(folder / "out" / "x", outside),
        "folder outside": lambda: (folder / "new").mkdir(),
    }
    seen = {}
    for name, plant in plants.items():
        topcli.__main__.main = plant
        said = call(["run"], folder, [folder / "out"], limit=0.3 if name in ("hang", "slow") else 30.0)
        seen[name] = sorted({kind for kind, _ in judged(said)})
    print(json.dumps(seen))


if __name__ == "__main__":
    main()
