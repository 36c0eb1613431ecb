"""Schemes from outside: an installed package, a file, and what a broken one may not do."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from conftest import ROOT

HK = str(ROOT / "configs" / "kowalevski_hk.yaml")
EXAMPLE = ROOT / "examples" / "topcli-example-scheme"


def topcli(*arguments: str, cwd: Path, path: Path | None = None) -> subprocess.CompletedProcess[str]:
    environment = dict(os.environ)
    if path:
        environment["PYTHONPATH"] = os.pathsep.join([str(path), *filter(None, [os.environ.get("PYTHONPATH")])])
    return subprocess.run(
        [sys.executable, "-m", "topcli", *arguments],
        capture_output=True,
        text=True,
        cwd=cwd,
        env=environment,
        check=False,
    )


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


@pytest.mark.slow
def test_an_installed_scheme_equals_the_built_in_bit_for_bit(installed: Path, tmp_path: Path) -> None:
    for scheme in ("bohlin-a", "example-bohlin-a"):
        settings = ["--set", f"scheme={scheme}", "--set", f"name={scheme}", "--set", "N=20000", "--format", "csv"]
        done = topcli("run", HK, *settings, "--quiet", cwd=tmp_path, path=installed)
        assert (done.returncode, done.stderr) == (0, "")
    ours, theirs = (tmp_path / "results" / name / "series.csv" for name in ("bohlin-a", "example-bohlin-a"))
    assert ours.read_bytes() == theirs.read_bytes()
    manifest = json.loads((theirs.parent / "manifest.json").read_text())
    assert manifest["scheme_origin"] == "topcli-example-scheme"
    listed = topcli("list", "schemes", "--json", cwd=tmp_path, path=installed)
    origins = {item["name"]: item["origin"] for item in json.loads(listed.stdout)["schemes"]}
    assert origins["example-bohlin-a"] == "topcli-example-scheme"
    assert origins["bohlin-a"] == "topcli"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("raise RuntimeError('no good')", "RuntimeError: no good"),
        ("import nonexistent_module_xyz", "nonexistent_module_xyz"),
        ("import sys; sys.exit(3)", "SystemExit: 3"),
        ("def (", "SyntaxError"),
    ],
)
def test_a_broken_plugin_is_named_and_stops_nothing_else(tmp_path: Path, text: str, reason: str) -> None:
    site = tmp_path / "site"
    (site / "broken-1.0.dist-info").mkdir(parents=True)
    (site / "broken_scheme.py").write_text(text)
    (site / "broken-1.0.dist-info" / "METADATA").write_text("Metadata-Version: 2.1\nName: broken\nVersion: 1.0\n")
    (site / "broken-1.0.dist-info" / "entry_points.txt").write_text("[topcli.schemes]\nbad = broken_scheme\n")
    done = topcli("run", HK, "--set", "N=20", "--quiet", cwd=tmp_path, path=site)
    assert done.returncode == 0
    found = json.loads(topcli("doctor", "--json", cwd=tmp_path, path=site).stdout)
    assert found["plugins"] == [{"name": "bad", "state": f"failed: {found['plugins'][0]['state'][8:]}"}]
    assert reason in found["plugins"][0]["state"]
    assert any("bad" in problem for problem in found["problems"])


SCHEME = """
import topcli
from topcli.contracts import Stepper

def step(s, h, p):
    return s

@topcli.scheme({name!r}, top={top!r}, title="rest", order=1, explicit=True, self_adjoint=True,
               citation="none", equations="y' = y")
def build(top, options):
    {doc!r}
    return Stepper(step, 6)
"""


def scheme_file(folder: Path, name: str = "rest", top: str = "kowalevski", doc: str = "Stay.") -> str:
    path = folder / "mine.py"
    path.write_text(SCHEME.format(name=name, top=top, doc=doc))
    return str(path)


def test_example_of_the_decorator_runs(tmp_path: Path) -> None:
    """In a process of its own, because the example registers a scheme."""
    code = "import doctest; from topcli.schemes import registry; print(*doctest.testmod(registry))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=tmp_path, check=True)
    failed, attempted = map(int, done.stdout.split()[-2:])
    assert (failed, attempted) == (0, 6), done.stdout


@pytest.mark.slow
def test_a_scheme_from_a_file(tmp_path: Path) -> None:
    file = scheme_file(tmp_path)
    done = topcli("run", HK, "--scheme-file", file, "--set", "scheme=rest", "--set", "N=20", "--json", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert {row["verdict"] for row in json.loads(done.stdout)["runs"][0]["invariants"]} == {"exact"}
    assert '"rest"' in topcli("list", "schemes", "--scheme-file", file, "--json", cwd=tmp_path).stdout


@pytest.mark.slow
def test_a_step_that_uses_complex_numbers_works_from_the_cache_too(tmp_path: Path) -> None:
    text = SCHEME.format(name="turn", top="kowalevski", doc="Turn omega.").replace(
        "return s\n",
        "z = cmath.exp(0.1j) * complex(s[0], s[1])\n    return (z.real, z.imag, s[2], s[3], s[4], s[5])\n",
        1,
    )
    (tmp_path / "turn.py").write_text("import cmath\n" + text)
    arguments = [
        "run",
        HK,
        "--name",
        "kowalevski_hk",
        "--scheme-file",
        "turn.py",
        "--set",
        "scheme=turn",
        "--set",
        "N=50",
        "--force",
    ]
    arguments += ["--format", "csv"]
    series = []
    for _ in range(2):
        done = topcli(*arguments, cwd=tmp_path)
        assert done.returncode == 0, done.stderr
        series.append((tmp_path / "results" / "kowalevski_hk" / "series.csv").read_bytes())
    assert series[0] == series[1]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"name": "hk"}, "already registered by topcli"),
        ({"top": "kowalewski"}, "did you mean 'kowalevski'"),
        ({"doc": ""}, "has no docstring"),
    ],
)
def test_a_file_that_cannot_be_registered_is_refused(tmp_path: Path, changes: dict[str, str], words: str) -> None:
    done = topcli("run", HK, "--scheme-file", scheme_file(tmp_path, **changes), cwd=tmp_path)
    assert done.returncode == 2
    assert words in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1


@pytest.mark.slow
def test_a_file_without_a_scheme_is_refused(tmp_path: Path) -> None:
    (tmp_path / "empty.py").write_text("x = 1\n")
    done = topcli("run", HK, "--scheme-file", "empty.py", cwd=tmp_path)
    assert done.returncode == 2
    assert "registers no scheme" in done.stderr


@pytest.mark.slow
@pytest.mark.parametrize("body", ["return s[0]", "return (s[0], s[1])", "return open('x')", "return (*s, 1.0)"])
def test_a_step_that_cannot_be_compiled_is_named(tmp_path: Path, body: str) -> None:
    text = SCHEME.format(name="odd", top="kowalevski", doc="Odd.").replace("return s\n", f"{body}\n", 1)
    (tmp_path / "odd.py").write_text(text)
    done = topcli("run", HK, "--scheme-file", "odd.py", "--set", "scheme=odd", "--set", "N=50", cwd=tmp_path)
    assert done.returncode in (1, 2), done.stderr
    assert "Traceback" not in done.stderr
    assert "odd.py:" in done.stderr
    assert len(done.stderr.strip().splitlines()) <= 3


MEASURE = """
import topcli

@topcli.measure("omega1.{end}", summary="{end} omega1 of the run", unit="rate", needs=["omega1"])
def found(batch):
    return batch.columns["omega1"].{end}(axis=1)
"""


@pytest.mark.slow
def test_a_file_may_hold_measures_alone(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(MEASURE.format(end="max"))
    listed = topcli("list", "measures", "--scheme-file", "mine.py", "--json", cwd=tmp_path)
    assert listed.returncode == 0, listed.stderr
    found = {item["name"]: item for item in json.loads(listed.stdout)["measures"]}
    assert found["omega1.max"]["summary"] == "max omega1 of the run"
    assert found["omega1.max"]["origin"] == "mine.py"
    assert found["seconds"]["origin"] == "topcli"
    assert "omega1.max" not in topcli("list", "measures", cwd=tmp_path).stdout


@pytest.mark.slow
def test_an_installed_plugin_may_register_measures_alone(tmp_path: Path) -> None:
    """Both of its measures come from the plugin although it is the first to import topcli's."""
    site = tmp_path / "site"
    (site / "measuring-1.0.dist-info").mkdir(parents=True)
    (site / "measuring.py").write_text(MEASURE.format(end="min"))
    (site / "measuring-1.0.dist-info" / "METADATA").write_text("Metadata-Version: 2.1\nName: measuring\nVersion: 1.0\n")
    (site / "measuring-1.0.dist-info" / "entry_points.txt").write_text("[topcli.schemes]\nmeasuring = measuring\n")
    listed = json.loads(topcli("list", "measures", "--json", cwd=tmp_path, path=site).stdout)["measures"]
    assert {item["name"] for item in listed if item["origin"] == "measuring"} == {"omega1.min"}
    doctor = topcli("doctor", "--json", cwd=tmp_path, path=site)
    (plugin,) = json.loads(doctor.stdout)["plugins"]
    assert plugin == {"name": "measuring", "state": "registers omega1.min"}


@pytest.mark.slow
def test_the_entry_points_of_a_package_have_their_own_schemes(tmp_path: Path) -> None:
    """One registers a scheme, one a top, one nothing; what they import from elsewhere counts for all of them."""
    package = tmp_path / "site" / "several"
    info = package.parent / "several-1.0.dist-info"
    info.mkdir(parents=True)
    package.mkdir()
    (package / "__init__.py").write_text("")
    (package / "first.py").write_text(SCHEME.format(name="rest", top="kowalevski", doc="Stay."))
    (package / "second.py").write_text(MEASURE.format(end="min"))
    imports = "from topcli.tops import TOPS\nfrom topcli.tops.heavy import Heavy\n"
    (package / "third.py").write_text(f"{imports}class Own(Heavy):\n    kind = form = 'own'\nTOPS['own'] = Own\n")
    (package / "fourth.py").write_text("import several.first\n")
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: several\nVersion: 1.0\n")
    names = ("first", "second", "third", "fourth")
    (info / "entry_points.txt").write_text(
        "[topcli.schemes]\n" + "".join(f"{name} = several.{name}\n" for name in names)
    )
    found = json.loads(topcli("doctor", "--json", cwd=tmp_path, path=package.parent).stdout)
    states = {one["name"]: one["state"] for one in found["plugins"]}
    assert states == {
        "first": "registers rest",
        "second": "registers omega1.min",
        "third": "registers own",
        "fourth": "registers no scheme, measure or top",
    }
    assert found["problems"] == ["plugin fourth registers no scheme, measure or top"]
