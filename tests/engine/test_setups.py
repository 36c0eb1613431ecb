"""Set-ups of closed forms: kept on disk, trusted only as they were stored, computed in several processes."""

from __future__ import annotations

import contextlib
import json
import os
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from cases import numbers_of
from conftest import GEN, Said, random_states
from steppers import built
from topcli.contracts import Accuracy, Sampler
from topcli.engine import setups
from topcli.engine.code_cache import cache_state
from topcli.engine.ensemble import EnsembleRun, Execution, Piece
from topcli.engine.run import Run
from topcli.engine.setups import SetupTime, prepare, setup_processes
from topcli.errors import RunError
from topcli.schemes.kowalevski import exact
from topcli.schemes.kowalevski.closed_form import motion_bytes, motion_from
from topcli.schemes.kowalevski.exact import ExactSetup
from topcli.tops.kowalevski import Kowalevski

Y, P = np.array(GEN), (1.0,)
N = np.array([0, 7, 10**6, 10**12], dtype=np.int64)


def method() -> Sampler:
    found = built("exact")
    assert isinstance(found, Sampler)
    return found


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The folder of an empty cache, and no motion in memory."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    exact._kept().clear()
    yield tmp_path / "topcli"
    exact._kept().clear()


class Counted(ExactSetup):
    """The set-up of the closed form, which counts its computations."""

    computed = 0

    def compute(self, y0, p) -> bytes:
        type(self).computed += 1
        return super().compute(y0, p)


@pytest.fixture
def counted(folder: Path) -> Counted:
    Counted.computed = 0
    return Counted()


def again(setup: Counted, y0=Y, p=P) -> tuple[bool, int]:
    """Prepare as another process would: (True if it came from the cache, number of computations so far)."""
    exact._kept().clear()
    return prepare(setup, y0, p).cached, Counted.computed


def test_a_set_up_is_computed_once(counted: Counted, folder: Path) -> None:
    assert again(counted) == (False, 1)
    assert prepare(counted, Y, P).cached  # from memory
    states = method().states(Y, 0.1, N, P)
    assert again(counted) == (True, 1)
    np.testing.assert_array_equal(method().states(Y, 0.1, N, P), states)
    assert Counted.computed == 1
    (path,) = folder.glob("*.setup")
    assert path.stat().st_mode & 0o777 == 0o600
    assert cache_state().entries == 1


@pytest.mark.slow
def test_states_are_those_of_a_fresh_set_up(counted: Counted) -> None:
    """Motions of every kind, by the bits of their states."""
    starts = numbers_of("""
generic: 0.7 -0.4 1.3 0.6 0.48 0.64
a triple root with k = 0: 0 0 1.5 0 0 1
another one: 1 0 1 0 0 -1
a pendulum: 0 0 1 0.6 0.8 0
next to its separatrix: 0 0 1.4142135623730951 0 1 0
on its separatrix: 0 0 2 -1 0 0
s1 and s2 meet: 0.5 0.25 0 0 0 1
""")
    for y in starts.values():
        exact._kept().clear()
        fresh = method().states(np.array(y), 0.1, N, P)
        assert again(counted, np.array(y))[0] is False
        assert again(counted, np.array(y))[0] is True
        np.testing.assert_array_equal(method().states(np.array(y), 0.1, N, P), fresh)


@pytest.mark.slow
def test_the_key_holds_all_that_matters(counted: Counted, monkeypatch: pytest.MonkeyPatch) -> None:
    """One ulp of the state or of c, the code, the version and the class are other set-ups."""
    assert again(counted) == (False, 1)
    for i in (0, 5):
        moved = Y.copy()
        moved[i] = np.nextafter(moved[i], 9.0)
        assert not again(counted, moved)[0]
    assert again(counted, Y, (float(np.nextafter(1.0, 2.0)),)) == (False, 4)
    for owner, name, other in ((Counted, "code", lambda self: "other code"), (setups, "__version__", "0")):
        with monkeypatch.context() as patch:
            patch.setattr(owner, name, other)
            assert not again(counted)[0]
    assert again(counted) == (True, 6)


def test_the_code_is_that_of_the_sources(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    here = Path(exact.__file__).parent
    package = tmp_path / "topcli"
    for folder in ("schemes/kowalevski", "schemes/kowalevski/closed_form", "arithmetic"):
        (package / folder).mkdir(parents=True)
        for path in (here.parents[1] / folder).glob("*.py"):
            (package / folder / path.name).write_bytes(path.read_bytes())
    known = ExactSetup().code()
    monkeypatch.setattr(exact, "__file__", str(package / "schemes/kowalevski/exact.py"))
    assert ExactSetup().code() == known
    for changed in ("schemes/kowalevski/closed_form/oval.py", "arithmetic/elliptic.py"):
        before = ExactSetup().code()
        (package / changed).write_text((package / changed).read_text() + "# changed\n")
        assert ExactSetup().code() != before


@pytest.mark.slow
def test_the_set_up_of_another_state_is_not_used(counted: Counted, folder: Path) -> None:
    again(counted)
    (mine,) = folder.glob("*.setup")
    again(counted, -Y)
    (other,) = set(folder.glob("*.setup")) - {mine}
    mine.write_bytes(other.read_bytes())  # with a valid checksum
    assert again(counted) == (False, 3)


def test_a_cache_that_cannot_be_written(counted: Counted, folder: Path) -> None:
    folder.write_text("not a folder")
    assert again(counted) == (False, 1)
    assert again(counted) == (False, 2)


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"1",
        b"[]",
        b'["object","Path",{}]',
        b'["object","OvalTable",[]]',
        b'["fraction",1,0]',
        b'["array","|O",[1],"AAAA"]',
        b"[" * 99_999,
    ],
)
def test_other_bytes_are_no_motion(data: bytes) -> None:
    with pytest.raises(ValueError, match="no stored motion"):
        motion_from(data)


def test_only_known_classes_are_stored() -> None:
    with pytest.raises(TypeError, match="an object of type PosixPath"):
        motion_bytes(Path("x"))  # pyright: ignore[reportArgumentType]


def collected(y0: np.ndarray, threads: int) -> tuple[np.ndarray, SetupTime]:
    rows: list[np.ndarray] = []

    def made(piece: Piece) -> None:
        rows.append(piece.states[0].copy())

    run = EnsembleRun(Kowalevski(), method(), y0, 0.5, 20, 5, on_piece=made, execution=Execution(threads=threads))
    for _ in run:
        pass
    assert run.setup is not None
    return np.concatenate(rows), run.setup


@pytest.mark.slow
def test_processes_change_no_bit(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    y0 = random_states(30, 3)
    assert setup_processes(ExactSetup(), 30, 2) == 2
    assert setup_processes(ExactSetup(), 3, 2) == 0
    begun: list[int] = []
    start = setups._Worker.__init__
    monkeypatch.setattr(setups._Worker, "__init__", lambda self, *one: (begun.append(1), start(self, *one))[1])
    many, seconds = collected(y0, 2)
    assert (len(begun), seconds.cached) == (2, False)
    assert seconds.seconds > 0.0
    exact._kept().clear()
    stored, seconds = collected(y0, 2)
    assert seconds.cached
    exact._kept().clear()
    monkeypatch.setenv("NUMBA_CACHE_DIR", os.devnull)
    monkeypatch.setattr(setups, "WORTH_WORKERS", 1e9)
    alone, seconds = collected(y0, 2)
    assert (len(begun), seconds.cached) == (4, False)
    np.testing.assert_array_equal(many, alone)
    np.testing.assert_array_equal(stored, alone)


@pytest.mark.slow
def test_a_dead_process_costs_time_only(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(setups, "WORTH_WORKERS", 0.0)
    monkeypatch.setattr(setups, "WORKER", "topcli.engine.no_such_module")
    y0 = random_states(3, 4)
    found, _ = collected(y0, 2)
    np.testing.assert_array_equal(found[1:5], method().states(y0[0], 0.5, np.arange(5, 21, 5), P))


@pytest.mark.slow
def test_the_report_shows_set_up_and_accuracy(folder: Path, cli: Callable[..., Said]) -> None:
    config = ("run", "kowalevski_hk", "--set", "scheme=exact", "--set", "N=1000", "--set", "name=one")
    said = cli(*config, "--verbose")
    assert "round-off at most about 3e-15 (eps |omega|²/c in gamma)" in said.err
    (first,) = cli(*config, "--json").json()["runs"]
    assert first["seconds"]["setup"] > 0.0
    assert first["seconds"]["setup_cached"] is False
    exact._kept().clear()
    (second,) = cli(*config, "--force", "--json").json()["runs"]
    assert second["seconds"]["setup_cached"] is True
    assert second["accuracy"] == first["accuracy"]
    assert set(first["accuracy"]) == set(Accuracy._fields)
    text = Path("results/one/report.md").read_text()
    assert f"loading the set-up {second['seconds']['setup']:.3g} s" in text
    assert f"changes the states by up to {second['accuracy']['sensitivity']:.0e}." in text
    (stepped,) = cli("run", "kowalevski_hk", "--set", "N=10", "--set", "name=two", "--json").json()["runs"]
    assert "setup" not in stepped["seconds"]
    assert "accuracy" not in stepped


@pytest.mark.slow
def test_the_sensitivity_is_the_change_by_one_ulp() -> None:
    """Next to the separatrix omega3 = 2, where an ulp grows like e^(t/√2)."""
    y = np.array([1e-6, 0.0, 2.0, 0.0, 0.0, 1.0])
    found = method().accuracy
    assert found is not None
    moved = np.nextafter(y, np.where(y == 0.0, 0.0, 9.0))
    n = np.arange(0, 40, 2)
    change = np.abs(method().states(moved, 1.0, n, P) - method().states(y, 1.0, n, P)).max()
    assert found(y, 1.0, n, P).sensitivity == change
    assert change == pytest.approx(2.59e-5, rel=0.05)
    assert found(np.array([2.0, 0, 0, 1.0, 0, 0]), 1.0, n, P).round_off == 0.0


@pytest.mark.slow
def test_an_ensemble_states_the_time_of_its_set_ups(
    folder: Path, cli: Callable[..., Said], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(ExactSetup, "seconds", 50.0)
    config = tmp_path / "few.yaml"
    config.write_text(
        "top: {kind: kowalevski}\nensemble: {random: {count: 2, seed: 1, gamma: sphere, omega: {sphere: 1}}}\n"
        "scheme: exact\nh: 0.1\nN: 10\n"
    )
    said = cli("run", str(config), "--threads", "1")
    assert "few: the set-up of 2 closed forms takes about 100 s in 1 process, less if some are stored" in said.err
    assert "set-up" not in cli("run", str(config), "--quiet", "--force").err
    (report,) = cli("run", str(config), "--force", "--json").json()["runs"]
    assert report["seconds"]["setup_cached"] is True
    assert f"loading the set-up {report['seconds']['setup']:.3g} s" in Path("results/few/report.md").read_text()


def test_what_the_closed_form_refuses_ends_the_run(folder: Path) -> None:
    with pytest.raises(RunError, match="too weak"):
        Run(Kowalevski(c0=1e-300), method(), GEN, 0.1, 5).collect()


def test_only_the_motion_of_its_state_is_taken(folder: Path) -> None:
    """With a right checksum too, as the user alone can write it: another motion, or one without an attribute."""
    setup, other = ExactSetup(), Y + np.array([1e-3, 0, 0, 0, 0, 0])
    whole, another = setup.compute(Y, P), setup.compute(other, P)
    exact._kept().clear()
    plain = json.loads(whole)
    for name in list(plain[2]):
        less = [*plain[:2], {key: value for key, value in plain[2].items() if key != name}]
        with contextlib.suppress(ValueError):  # some attributes are not needed for states
            setup.use(Y, P, json.dumps(less).encode())
            assert np.abs(exact.exact_states(Y, 0.01, N[:1], P)[0] - Y).max() < 1e-12
        exact._kept().clear()
    with pytest.raises(ValueError, match="the motion of another state"):
        setup.use(Y, P, another)
    assert setup.needed(Y, P)
    setup.use(Y, P, whole)
    assert not setup.needed(Y, P)
