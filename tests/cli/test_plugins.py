"""Installed packages with schemes, measures and tops, and what a broken one may not do."""

from __future__ import annotations

import json
import subprocess
import sys
import zipfile
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from conftest import ROOT
from injected import python_process, topcli_process

pytestmark = pytest.mark.slow

HK = str(ROOT / "configs" / "kowalevski_hk.yaml")
EXAMPLE = ROOT / "examples" / "topcli-example-scheme"


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The example package, built into a wheel and unpacked into a target folder: what an installer does."""
    folder = tmp_path_factory.mktemp("example")
    subprocess.run(
        [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder / "dist")],
        cwd=EXAMPLE,
        check=True,
        capture_output=True,
    )
    (wheel,) = (folder / "dist").glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(folder / "site-packages")
    return folder / "site-packages"


def test_an_installed_scheme_equals_the_built_in_bit_for_bit(installed: Path, tmp_path: Path) -> None:
    for scheme in ("bohlin-a", "example-bohlin-a"):
        settings = ["--set", f"scheme={scheme}", "--set", f"name={scheme}", "--set", "N=20000"]
        settings += ["--set", "output.format=csv"]
        done = topcli_process("run", HK, *settings, "--quiet", cwd=tmp_path, path=installed)
        assert (done.returncode, done.stderr) == (0, "")
    ours, theirs = (tmp_path / "results" / name / "series.csv" for name in ("bohlin-a", "example-bohlin-a"))
    assert ours.read_bytes() == theirs.read_bytes()
    source = EXAMPLE / "src" / "topcli_example_scheme.py"
    assert (theirs.parent / "source.topcli_example_scheme.py").read_text() == source.read_text()
    manifest = json.loads((theirs.parent / "manifest.json").read_text())
    assert manifest["scheme_origin"] == "topcli_example_scheme"
    listed = topcli_process("list", "schemes", "--json", cwd=tmp_path, path=installed)
    origins = {item["name"]: item["origin"] for item in json.loads(listed.stdout)["schemes"]}
    assert origins["example-bohlin-a"] == "topcli_example_scheme"
    assert origins["bohlin-a"] == "topcli"


SCHEME = """
import topcli
from topcli.contracts import Stepper

@topcli.scheme("rest", top="kowalevski", order=1, explicit=True, self_adjoint=True)
def build(top, options):
    "Stay."
    return Stepper(lambda s, h, p: s, 6)
"""
MEASURE = """
import topcli

@topcli.measure("omega1.min", summary="min omega1 of the run", unit="rate", needs=["omega1"])
def found(batch):
    return batch.columns["omega1"].min(axis=1)
"""
TOP = """
import topcli
from topcli.tops import TOPS
@topcli.top
class Own(TOPS["heavy"]):
    kind = form = 'own'
"""


def install(folder: Path, group: str = "topcli.schemes", **modules: str) -> Path:
    """Install a package ``several`` with these modules, each an entry point; the folder of packages."""
    package, info = folder / "site-packages" / "several", folder / "site-packages" / "several-1.0.dist-info"
    package.mkdir(parents=True)
    info.mkdir()
    for name, text in {"__init__": "", **modules}.items():
        (package / f"{name}.py").write_text(text)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: several\nVersion: 1.0\n")
    points = [f"{name} = several.{name}\n" for name in modules]
    (info / "entry_points.txt").write_text("".join([f"[{group}]\n", *points]))
    return folder / "site-packages"


def test_broken_plugins_are_named_and_stop_nothing_else(tmp_path: Path) -> None:
    broken = {
        "raises": ("raise RuntimeError('no good')", "RuntimeError: no good"),
        "lacks": ("import nonexistent_module_xyz", "nonexistent_module_xyz"),
        "leaves": ("import sys; sys.exit(3)", "SystemExit: 3"),
        "typo": ("def (", "SyntaxError"),
        "late": (f"{SCHEME}\nraise ValueError('too late')", "ValueError: too late"),
    }
    site = install(tmp_path, **{name: text for name, (text, _) in broken.items()})
    listed = topcli_process("list", "schemes", "--json", cwd=tmp_path, path=site)
    assert {item["origin"] for item in json.loads(listed.stdout)["schemes"]} == {"topcli", "several"}  # of late.py
    for name, (_, reason) in broken.items():
        (line,) = (line for line in listed.stderr.splitlines() if f"plugin '{name}' " in line)
        assert reason in line
    assert topcli_process("run", HK, "--set", "N=20", "--quiet", cwd=tmp_path, path=site).returncode == 0


CONFIG = "{top: %s, initial: {omega: [0.7, -0.4, 1.3], gamma: [0.6, 0.48, 0.64]}, scheme: rk4, h: 0.01, N: 40}"
FIGURE = """
import numpy as np
import topcli

def draw(canvas, columns):
    canvas.subplots().plot(columns["t"], columns["y"])

@topcli.figure("parabola", "A parabola", draw)
def parabola():
    t = np.linspace(0, 1, 5)
    return {"t": t, "y": t * t}
"""
MARK = "import pathlib; pathlib.Path('{}.imported').touch()\n"


def test_a_plugin_is_imported_when_a_name_needs_it(tmp_path: Path) -> None:
    """Built-in names need none, other names all."""
    modules = {"rest": SCHEME, "own": TOP, "other": MEASURE}
    site = install(tmp_path, "topcli.tops", **{name: MARK.format(name) + text for name, text in modules.items()})
    (tmp_path / "own.yaml").write_text(CONFIG % "own")
    for command, imported in (
        (("run", HK, "--set", "N=20"), []),
        (("show", HK), []),
        (("run", HK, "--set", "N=20", "--set", "scheme=rest"), ["other", "own", "rest"]),
        (("run", "own.yaml"), ["other", "own", "rest"]),
        (("list", "measures"), ["other", "own", "rest"]),
    ):
        done = topcli_process(*command, cwd=tmp_path, path=site)
        assert done.returncode == 0, done.stderr
        marks = list(tmp_path.glob("*.imported"))
        assert sorted(path.stem for path in marks) == imported
        for path in marks:
            path.unlink()
    for kind, name in {"measures": "omega1.min", "schemes": "rest", "tops": "own"}.items():
        listed = json.loads(topcli_process("list", kind, "--json", cwd=tmp_path, path=site).stdout)[kind]
        assert {item["name"] for item in listed if item["origin"] == "several"} == {name}


BAD = "raise RuntimeError('no good')"
ALONE = "from topcli.figures.catalogue import FIGURES\nFIGURES.clear()\n"
"""Leaves only the figures of a plugin, so that a test draws no other."""
SAID = "plugin 'bad' of several failed: {site}/several/bad.py:1: RuntimeError: no good"


def test_a_broken_plugin_stops_only_what_names_it(tmp_path: Path) -> None:
    site = install(tmp_path, bad=BAD)
    (tmp_path / "bad.yaml").write_text(CONFIG % "bad")
    said = SAID.format(site=site)

    def call(code: int, *command: str) -> tuple[str, str]:
        done = topcli_process(*command, cwd=tmp_path, path=site)
        assert (done.returncode, "Traceback" in done.stderr) == (code, False), done.stderr
        assert said in done.stderr
        return done.stdout, done.stderr

    tried, errors = call(0, "stress", "rk4", "--case", "one-step", "--top", "euler")
    assert "held" in tried
    assert errors.count("no good") == 1
    for command in (
        ("run", HK, "--set", "scheme=bad"),
        ("run", "bad.yaml"),
        ("plot", "bad"),
        ("compare", "hk", "bad", "--set", "N=200"),
        ("run", HK, "--set", "top=other"),
    ):
        _, errors = call(2, *command)
        assert len(errors.splitlines()) <= 2


def test_figures_of_plugins_are_drawn(tmp_path: Path) -> None:
    """``--all`` too draws them; a broken plugin is named."""
    site = install(tmp_path, "topcli.figures", alone=ALONE + FIGURE, bad=BAD)
    done = topcli_process("plot", "--all", "--format", "png", "--json", cwd=tmp_path, path=site)
    assert (done.returncode, SAID.format(site=site) in done.stderr) == (0, True)
    (drawn,) = json.loads(done.stdout)["figures"]
    assert drawn["name"] == "parabola"
    y = pq.read_table(tmp_path / drawn["files"][-1])["y"].to_pylist()
    assert y == [0.0, 0.0625, 0.25, 0.5625, 1.0]


def test_example_of_the_decorator_runs(tmp_path: Path) -> None:
    """In a process of its own, because the example registers a scheme."""
    code = "import doctest; from topcli.schemes import registry; print(*doctest.testmod(registry))"
    done = python_process(code, cwd=tmp_path)
    failed, attempted = map(int, done.stdout.split()[-2:])
    assert (failed, attempted) == (0, 6), done.stdout
