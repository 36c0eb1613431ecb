"""Installed packages with schemes, measures and tops, and what a broken one may not do."""

from __future__ import annotations

import json
import subprocess
import sys
import zipfile
from pathlib import Path

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
        archive.extractall(folder / "site")
    return folder / "site"


def test_an_installed_scheme_equals_the_built_in_bit_for_bit(installed: Path, tmp_path: Path) -> None:
    for scheme in ("bohlin-a", "example-bohlin-a"):
        settings = ["--set", f"scheme={scheme}", "--set", f"name={scheme}", "--set", "N=20000", "--format", "csv"]
        done = topcli_process("run", HK, *settings, "--quiet", cwd=tmp_path, path=installed)
        assert (done.returncode, done.stderr) == (0, "")
    ours, theirs = (tmp_path / "results" / name / "series.csv" for name in ("bohlin-a", "example-bohlin-a"))
    assert ours.read_bytes() == theirs.read_bytes()
    manifest = json.loads((theirs.parent / "manifest.json").read_text())
    assert manifest["scheme_origin"] == "topcli-example-scheme"
    listed = topcli_process("list", "schemes", "--json", cwd=tmp_path, path=installed)
    origins = {item["name"]: item["origin"] for item in json.loads(listed.stdout)["schemes"]}
    assert origins["example-bohlin-a"] == "topcli-example-scheme"
    assert origins["bohlin-a"] == "topcli"


SCHEME = """
import topcli
from topcli.contracts import Stepper

@topcli.scheme("rest", top="kowalevski", title="rest", order=1, explicit=True, self_adjoint=True,
               citation="none", equations="y' = y")
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
from topcli.tops.heavy import Heavy
@topcli.top
class Own(Heavy):
    kind = form = 'own'
"""


def install(folder: Path, **modules: str) -> Path:
    """Install a package ``several`` with these modules, each an entry point; the folder of packages."""
    package, info = folder / "site" / "several", folder / "site" / "several-1.0.dist-info"
    package.mkdir(parents=True)
    info.mkdir()
    for name, text in {"__init__": "", **modules}.items():
        (package / f"{name}.py").write_text(text)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: several\nVersion: 1.0\n")
    points = [f"{name} = several.{name}\n" for name in modules]
    (info / "entry_points.txt").write_text("".join(["[topcli.schemes]\n", *points]))
    return folder / "site"


def test_broken_plugins_are_named_and_stop_nothing_else(tmp_path: Path) -> None:
    broken = {
        "raises": ("raise RuntimeError('no good')", "RuntimeError: no good"),
        "lacks": ("import nonexistent_module_xyz", "nonexistent_module_xyz"),
        "leaves": ("import sys; sys.exit(3)", "SystemExit: 3"),
        "typo": ("def (", "SyntaxError"),
        "late": (f"{SCHEME}\nraise ValueError('too late')", "ValueError: too late"),
    }
    site = install(tmp_path, **{name: text for name, (text, _) in broken.items()})
    listed = json.loads(topcli_process("list", "schemes", "--json", cwd=tmp_path, path=site).stdout)["schemes"]
    assert {item["origin"] for item in listed} == {"topcli"}
    assert topcli_process("run", HK, "--set", "N=20", "--quiet", cwd=tmp_path, path=site).returncode == 0
    found = json.loads(topcli_process("doctor", "--json", cwd=tmp_path, path=site).stdout)
    states = {plugin["name"]: plugin["state"] for plugin in found["plugins"]}
    assert states.keys() == broken.keys()
    for name, (_, reason) in broken.items():
        assert states[name].startswith("failed: ")
        assert reason in states[name]
        assert any(name in problem for problem in found["problems"])


def test_the_entry_points_of_a_package_have_their_own_schemes(tmp_path: Path) -> None:
    """Their imports from elsewhere count for all of them, and topcli's measures for none."""
    modules = {"first": MEASURE, "second": SCHEME, "third": TOP, "fourth": "import several.first\n"}
    site = install(tmp_path, **modules)
    found = json.loads(topcli_process("doctor", "--json", cwd=tmp_path, path=site).stdout)
    assert {one["name"]: one["state"] for one in found["plugins"]} == {
        "first": "registers omega1.min",
        "second": "registers rest",
        "third": "registers own",
        "fourth": "registers no scheme, measure or top",
    }
    assert found["problems"] == ["plugin fourth registers no scheme, measure or top"]
    listed = json.loads(topcli_process("list", "measures", "--json", cwd=tmp_path, path=site).stdout)["measures"]
    assert {item["name"] for item in listed if item["origin"] == "several"} == {"omega1.min"}
    run = ["run", HK, "--set", "scheme=rest", "--set", "N=20", "--json"]
    (report,) = json.loads(topcli_process(*run, cwd=tmp_path, path=site).stdout)["runs"]
    assert {row["verdict"] for row in report["invariants"]} == {"exact"}


def test_example_of_the_decorator_runs(tmp_path: Path) -> None:
    """In a process of its own, because the example registers a scheme."""
    code = "import doctest; from topcli.schemes import registry; print(*doctest.testmod(registry))"
    done = python_process(code, cwd=tmp_path)
    failed, attempted = map(int, done.stdout.split()[-2:])
    assert (failed, attempted) == (0, 6), done.stdout
