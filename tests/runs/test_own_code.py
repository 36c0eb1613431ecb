"""Code of users as part of an experiment: what changes its digest, what does not, and what its manifest names."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from pathlib import Path

import pytest

from conftest import ROOT, Said
from documentation import read_page
from scheme_files import loaded_file
from topcli.config.load import load_experiment
from topcli.errors import UsageError
from topcli.plugins import load_plugin_file

FILES = read_page(ROOT / "docs" / "own.md").files()


HELPED = "from turning import field\n" + FILES["gyrostat.py"].replace("field = Gyrostat.field", "")
"""The file of the page, with the field in a package beside it."""


def write_helped(folder: Path) -> dict[str, str]:
    """Write the file and its package; their texts by the names of the copies in a run folder."""
    equations = FILES["gyrostat.py"].partition("def field")[2].partition("integrals =")[0]
    texts = {
        "gyrostat.py": HELPED,
        "turning/__init__.py": "from turning.equations import field\n",
        "turning/equations.py": "def field" + equations.replace("\n    ", "\n"),
        "turning/late.py": "x = 1.0\n",
    }
    (folder / "turning").mkdir()
    for name, text in texts.items():
        (folder / name).write_text(text)
    return {f"source.{name.replace('/', '.')}": text for name, text in texts.items()}


def test_a_module_named_like_that_of_another_file_is_refused(tmp_path: Path) -> None:
    """Its code would be that of the other one."""
    for name in ("here", "there"):
        (tmp_path / name).mkdir()
        write_helped(tmp_path / name)
    with (
        loaded_file(tmp_path / "here" / "gyrostat.py"),
        pytest.raises(UsageError, match=r"a module 'turning' is loaded already, from .*here.*; rename"),
    ):
        load_plugin_file(tmp_path / "there" / "gyrostat.py")


FIELD = ("(A - B) * w1 * w2 / C", "(A - B) * w2 * w1 / C")
"""The same field, written otherwise: another one would not conserve the integrals of the file."""


ENERGY = ("+ p[2] * y[2] ** 2) / 2", "+ p[2] * y[2] ** 2) / 3")
"""Another integral."""


@pytest.fixture
def folder(cli: Callable[..., Said]) -> Path:
    """The working folder, with the files of the page."""
    for name, text in FILES.items():
        Path(name).write_text(text)
    return Path()


def edit(path: Path, old: str, new: str) -> None:
    text = path.read_text()
    assert text.count(old) == 1
    path.write_text(text.replace(old, new))


def digests(path: Path) -> dict[str, str]:
    """Digests of the experiment under a scheme of the file and under one of topcli."""
    with loaded_file(path):
        return {name: load_experiment("rotor.yaml", [f"scheme={name}"]).digest for name in ("heun", "rk4")}


@pytest.mark.parametrize(
    ("file", "old", "new"),
    [
        ("gyrostat.py", *FIELD),
        ("gyrostat.py", *ENERGY),
        ("gyrostat.py", "d = 0.5 * h", "d = 0.5 * h  # half"),
        ("turning/equations.py", "def field", "def  field"),
        ("turning/late.py", "1.0", "2.0"),
        ("beside.py", "1.0", "1.0"),
    ],
)
def test_an_edit_of_a_file_or_of_what_it_imports_is_another_experiment(
    folder: Path, file: str, old: str, new: str
) -> None:
    """Also of what is imported later; but not of a file that is not imported."""
    (folder / "beside.py").write_text("x = 1.0\n")
    write_helped(folder)
    before = digests(folder / "gyrostat.py")
    edit(folder / file, old, new)
    after = digests(folder / "gyrostat.py")
    assert [before[name] != after[name] for name in before] == [old != new] * 2


@pytest.mark.parametrize("name", ["heun", "rk4"])
def test_an_edited_file_does_not_replace_the_earlier_run(cli: Callable[..., Said], folder: Path, name: str) -> None:
    """Under rk4 alike, although that is topcli's own scheme; the earlier run is renamed, and said so."""
    command = ("run", "rotor.yaml", "--plugin", "gyrostat.py", "--set", f"scheme={name}", "--set", "name=rotor")
    assert cli(*command).code == 0
    manifest = json.loads(Path("results/rotor/manifest.json").read_text())
    assert manifest["top_origin"] == "gyrostat.py"
    assert manifest["scheme_origin"] == ("gyrostat.py" if name == "heun" else "topcli")
    edit(folder / "gyrostat.py", *FIELD)
    again, earlier = cli(*command), Path(f"results/rotor-{manifest['key']}")
    assert again.code == 0
    assert f"renamed the earlier result to {earlier}" in again.err
    assert json.loads((earlier / "manifest.json").read_text()) == manifest
    new = json.loads(Path("results/rotor/manifest.json").read_text())
    assert (new["digest"] != manifest["digest"], new["config"] == manifest["config"]) == (True, True)


@pytest.mark.slow
def test_rows_of_a_sweep_are_computed_again_after_an_edit(cli: Callable[..., Said], folder: Path) -> None:
    """Also of an invariant, which no step uses."""
    sweep = "base: rotor.yaml\ngrid: {h: [0.01, 0.02]}\nmeasure: [max_deviation.energy]\n"
    (folder / "study.yaml").write_text(sweep)
    command = ("sweep", "study.yaml", "--plugin", "gyrostat.py")
    said = []
    for old, new in (("", ""), ("", ""), ENERGY):
        if old:
            edit(folder / "gyrostat.py", old, new)
        said.append(cli(*command))
    assert [one.code for one in said] == [0, 0, 0]
    assert ["(2 ran)" in one.out + one.err for one in said] == [True, False, True]


@pytest.mark.parametrize(("scheme", "N"), [("heun", 20), ("hk+suzuki4", 20), ("rk4", 20)])
def test_a_run_keeps_the_source_of_own_code(cli: Callable[..., Said], folder: Path, scheme: str, N: int) -> None:
    """Also of modules beside the file; a run of topcli's own parts keeps none."""
    texts = write_helped(folder)
    settings = ("--set", f"scheme={scheme}", "--set", f"N={N}", "--set", "T=null")
    assert cli("run", "rotor.yaml", "--plugin", "gyrostat.py", *settings, "--set", "name=kept").code == 0
    kept = {path.name: path.read_text() for path in Path("results/kept").glob("source.*")}
    assert kept == texts
    manifest = json.loads(Path("results/kept/manifest.json").read_text())
    digest = hashlib.sha256(HELPED.encode()).hexdigest()
    assert manifest["files"]["source.gyrostat.py"]["sha256"] == digest
    assert cli("verify", "kept").code == 0
    Path("results/kept/source.gyrostat.py").write_text("# other\n")
    assert "source.gyrostat.py: damaged" in cli("verify", "kept").err
    assert cli("run", "kowalevski_hk", "--plugin", "gyrostat.py", "--set", "N=20", "--set", "name=plain").code == 0
    assert not list(Path("results/plain").glob("source.*"))
