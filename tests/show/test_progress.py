"""Progress of functions: the widget of a notebook, a bar on a terminal, silence elsewhere."""

from __future__ import annotations

import io
import sys
from types import ModuleType
from typing import Any

import pytest

from topcli.show import progress


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.fixture
def notebook(monkeypatch: pytest.MonkeyPatch) -> None:
    """A process that looks like the kernel of a notebook."""
    monkeypatch.setitem(sys.modules, "IPython", ModuleType("IPython"))
    monkeypatch.setattr("rich.console._is_jupyter", lambda: True)
    monkeypatch.setattr(sys, "stderr", io.StringIO())


def ticks(*times: float) -> Any:
    return iter(times).__next__


def test_a_pipe_gets_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stderr", io.StringIO())
    monkeypatch.delitem(sys.modules, "IPython", raising=False)
    assert progress.progress_console() is None
    with progress.Progress("x", clock=ticks(0.0, 9.0)) as shown:
        shown(1, 2)
        assert shown._bar is None


@pytest.mark.usefixtures("notebook")
@pytest.mark.parametrize("widgets", [True, False])
def test_a_notebook_gets_its_widget_if_it_has_one(monkeypatch: pytest.MonkeyPatch, widgets: bool) -> None:
    """Without ipywidgets rich would print a warning instead of a bar."""
    monkeypatch.setattr(progress, "find_spec", lambda name: object() if widgets and name == "ipywidgets" else None)
    console = progress.progress_console()
    assert (console is not None) == widgets
    if console is not None:
        assert console.is_jupyter


def test_a_terminal_gets_a_bar_after_half_a_second(monkeypatch: pytest.MonkeyPatch) -> None:
    stream = Terminal()
    monkeypatch.setattr(sys, "stderr", stream)
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.delitem(sys.modules, "IPython", raising=False)
    with progress.Progress("[bold]run\x1b", clock=ticks(0.0, 0.4, 0.6, 5.0)) as shown:
        shown(1, 100)
        assert shown._bar is None
        shown(2, 100)
        shown(50, 100, "3 failed")
        assert shown._bar is not None
        from rich.console import Console

        console = Console(width=200)
        with console.capture() as captured:
            console.print(shown._bar.get_renderable())
    assert r"[bold]run\x1b" in captured.get()
    assert "50.0%  10.7 steps/s, 5 s left, 3 failed" in captured.get()
    assert shown._bar is None


@pytest.mark.parametrize(("shown", "term"), [(False, "xterm"), (True, "dumb")])
def test_no_bar_if_not_wanted_or_not_possible(monkeypatch: pytest.MonkeyPatch, shown: bool, term: str) -> None:
    monkeypatch.setattr(sys, "stderr", Terminal())
    monkeypatch.setenv("TERM", term)
    monkeypatch.delitem(sys.modules, "IPython", raising=False)
    with progress.Progress("x", shown, clock=ticks(0.0, 9.0, 10.0)) as silent:
        silent(1, 2)
        assert silent._bar is None
