"""Figures drawn by several processes: order, shared results, failures, interruption. A pipe holds a figure back."""

from __future__ import annotations

import multiprocessing as mp
import os
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from topcli.errors import RunError, TopcliError
from topcli.figures.catalogue import FIGURES
from topcli.figures.figure import Figure, Loaded, MadeFigure, Request, make_figures
from topcli.figures.picture import Line, Panel


class Gate:
    """A named pipe at which figures wait until it is opened for one of them."""

    def __init__(self, path: Path) -> None:
        os.mkfifo(path)
        self.path, self.end = path, os.open(path, os.O_RDWR)

    def open(self) -> None:
        os.write(self.end, b"x")


@pytest.fixture
def gate(tmp_path: Path) -> Iterator[Gate]:
    made = Gate(tmp_path / "gate")
    yield made
    os.close(made.end)


def straight(request: Request) -> Loaded:
    t = np.linspace(0.0, 1.0, 5)
    return Loaded((Panel((Line("t", "t"),), "t"),), lambda: {"t": t}, {})


def held(path: Path, request: Request) -> Loaded:
    """Wait at the gate ``path``; say so, and leave a file if interrupted there."""
    try:
        request.on_message("waiting")
        os.read(os.open(path, os.O_RDONLY), 1)
    except KeyboardInterrupt:
        path.with_suffix(f".{os.getpid()}").touch()
        raise
    return straight(request)


def failing(request: Request) -> Loaded:
    raise RunError("no such motion")


def dying(request: Request) -> Loaded:
    os._exit(7)


def figure(name: str, load: Callable[[Request], Loaded] = straight, rank: int = 2, *needs: str) -> Figure:
    return Figure(name, name, "none", load, needs, rank)


class Drawing:
    """Figures drawn by ``jobs`` processes, with ``when[name]`` called as the figure of this name starts."""

    def __init__(self, out: Path, when: dict[str, Callable[[], None]] | None = None) -> None:
        self.out, self.when, self.started = out, when or {}, list[str]()

    def start(self, name: str, done: int, total: int) -> None:
        if not done:
            self.started.append(name)
            self.when.get(name, lambda: None)()

    def __call__(
        self, figures: list[Figure], jobs: int, request: Request | None = None
    ) -> dict[str, MadeFigure | TopcliError]:
        request = request or Request(on_message=lambda line: None)
        outcomes = make_figures(figures, request, self.out, ["svg"], jobs, self.start)
        return {figure.name: outcome for figure, outcome in outcomes}


def test_figures_with_a_common_scene_wait_for_each_other(tmp_path: Path, gate: Gate) -> None:
    """``b`` needs what ``a`` makes, so ``c`` comes before it, and only then ``a`` may go on."""
    drawing = Drawing(tmp_path, {"c": gate.open})
    waiting = figure("a", partial(held, gate.path), 2, "scene")
    outcomes = drawing([waiting, figure("b", straight, 2, "other", "scene"), figure("c", straight, 2, "else")], 2)
    assert drawing.started == ["a", "c", "b"]
    assert {name: outcome.status for name, outcome in outcomes.items() if isinstance(outcome, MadeFigure)} == (
        dict.fromkeys("abc", "drawn")
    )
    assert all((tmp_path / f"{name}.{suffix}").is_file() for name in "abc" for suffix in ("svg", "parquet"))


def test_no_more_figures_than_jobs_and_the_first_ranks_first(tmp_path: Path, gate: Gate) -> None:
    """A third process would start before the first two have an outcome."""
    drawing = Drawing(tmp_path, {"paper": gate.open, "long": gate.open})
    figures = [figure("short"), figure("long", partial(held, gate.path), 1), figure("also"),
               figure("paper", partial(held, gate.path), 0)]  # fmt: skip
    seen = []
    for made, outcome in make_figures(
        figures, Request(on_message=lambda line: None), tmp_path, ["svg"], 2, drawing.start
    ):
        assert isinstance(outcome, MadeFigure)
        seen.append((made.name, len(drawing.started) - len(seen)))
    assert drawing.started == ["paper", "long", "short", "also"]
    assert {made for made, _ in seen} == set(drawing.started)
    assert max(running for _, running in seen) == 2


def test_a_failure_is_named_and_the_others_are_drawn(tmp_path: Path) -> None:
    outcomes = Drawing(tmp_path)([figure("bad", failing), figure("dead", dying), figure("good")], 2)
    assert isinstance(outcomes["good"], MadeFigure)
    assert [str(outcomes[name]) for name in ("bad", "dead")] == [
        "no such motion",
        "dead: its process ended with exit code 7",
    ]
    assert isinstance(outcomes["dead"], RunError)


def test_an_interruption_stops_every_process(tmp_path: Path, gate: Gate) -> None:
    """Both are interrupted in their runs, which they leave in order, and nothing is drawn after it."""
    heard = []

    def interrupted(line: str) -> None:
        heard.append(line)
        if len(heard) == 2:
            raise KeyboardInterrupt

    figures = [figure(name, partial(held, gate.path)) for name in "ab"]
    with pytest.raises(KeyboardInterrupt):
        Drawing(tmp_path)([*figures, figure("c")], 2, Request(on_message=interrupted))
    assert heard == ["waiting", "waiting"]
    assert not [process for process in mp.active_children() if process.name in "abc"]
    assert len(list(tmp_path.glob("gate.*"))) == 2
    assert not list(tmp_path.glob("*.svg"))


def test_the_catalogue_draws_the_figures_of_the_paper_first() -> None:
    assert [name for name, one in FIGURES.items() if one.rank == 0] == ["fig1", "fig2", "fig3", "fig4"]
