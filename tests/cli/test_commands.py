"""Commands through their real entry point: what they print, what they write, how they leave."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from cases import cases_of
from conftest import ROOT, Said
from injected import python_process, topcli_process
from topcli import __version__
from topcli.__main__ import main
from topcli.cli import options
from topcli.config.files import scene_files
from topcli.config.load import load_experiment

HK = str(ROOT / "configs" / "kowalevski_hk.yaml")
HYBRID = str(ROOT / "configs" / "kowalevski_hybrid.yaml")


def imported_by(tmp_path: Path, *arguments: str, after: str = "") -> list[str]:
    """Modules that a command imports in a process of its own, which runs the statement ``after`` at the end."""
    code = (
        f"import atexit, subprocess, sys; sys.argv = ['topcli', *{arguments!r}]\n"
        "started, init = [], subprocess.Popen.__init__\n"
        "def noted(self, args, *more, **options): started.append(args[0]); init(self, args, *more, **options)\n"
        "subprocess.Popen.__init__ = noted\n"
        "from topcli.__main__ import main\n"
        f"def report(): {after or 'pass'}; print(*sys.modules, sep='\\n')\n"
        "atexit.register(report); main()"
    )
    return python_process(code, cwd=tmp_path).stdout.splitlines()


HEAVY = {"numba", "scipy", "pandas", "matplotlib", "numpy.polynomial", "rich"}


def test_help_imports_no_heavy_package(tmp_path: Path) -> None:
    assert not {*HEAVY, "numpy", "pyarrow", "pydantic", "ruamel.yaml"} & set(imported_by(tmp_path, "--help"))


@pytest.mark.slow
def test_warm_run_is_light(tmp_path: Path) -> None:
    """A run whose machine code is known imports neither the compiler nor pandas nor SciPy, nor what others need.

    It starts one process, which asks for the commit, and looks for no plugins of pydantic.
    """
    topcli_process("run", HYBRID, "--set", "N=10", cwd=tmp_path)
    looks = "from pydantic.plugin import _loader; print(set(started) <= {'git'}, _loader._plugins)"
    found = imported_by(tmp_path, "run", "--force", "-q", "--set", "N=10", HYBRID, after=looks)
    others = "cli.inspect cli.plot cli.study studies.study tops.euler tops.lagrange"
    assert not (HEAVY | {f"topcli.{name}" for name in others.split()}) & set(found)
    assert found[0] == "True None"


@pytest.mark.slow
@pytest.mark.parametrize("option", [(), ("--motion",)])
def test_only_the_option_imports_the_closed_forms(option: tuple[str, ...], tmp_path: Path) -> None:
    found = set(imported_by(tmp_path, "show", "kowalevski_generic_hk", *option))
    assert ("topcli.analysis.motion.of_top" in found) == bool(option)
    assert not {"matplotlib", "pandas"} & found


def test_a_run_is_written_and_reported(cli, in_tmp: Path) -> None:
    assert cli("--version").out.startswith(f"topcli {__version__}\nPython ")
    planned = cli("run", HYBRID, "--dry-run")
    assert (planned.code, "50001 rows" in planned.out, list(in_tmp.iterdir())) == (0, True, [])
    said = cli("run", HYBRID)
    assert said.code == 0
    assert "completed 50000 steps" in said.err
    assert "verdict" in said.out
    assert (in_tmp / "results" / "kowalevski_hybrid" / "manifest.json").is_file()
    assert "up to date" in cli("run", HYBRID).err
    assert "up to date" in cli("run", HYBRID, "--dry-run").out
    assert cli("run", HYBRID, "--quiet") == Said(0, "", "")


def test_several_runs_have_titles_and_one_document(cli) -> None:
    titles = [
        line for line in cli("run", HK, HYBRID, "--set", "N=100").out.splitlines() if line.startswith("kowalevski")
    ]
    document = cli("run", HK, HYBRID, "--set", "N=100", "--json").json()
    assert document["schema_version"] == 1
    names = [run["name"] for run in document["runs"]]
    assert [name.partition("-")[0] for name in names] == ["kowalevski_hk", "kowalevski_hybrid"]
    assert all(title.startswith(name) for title, name in zip(titles, names, strict=True))


def test_one_failure_does_not_stop_the_other_runs(cli, in_tmp: Path) -> None:
    said = cli("run", "nonsense.yaml", HK, "--set", "N=50")
    assert said.code == 3
    assert list((in_tmp / "results").glob("kowalevski_hk-??????"))
    assert "1 of 2 runs succeeded; 1 failed" in said.err


@pytest.mark.parametrize(
    "settings", [("h=1.0", "initial.omega=[1e200, 1e200, 1e200]"), ("h=1e155",)], ids=["motion", "square of h"]
)
def test_blow_up_is_reported_and_its_rows_kept(cli, in_tmp: Path, settings: tuple[str, ...]) -> None:
    said = cli("run", HK, *(word for text in ("name=far", "N=50", *settings) for word in ("--set", text)))
    assert said.code == 1
    assert "blew up at step 1 (t = 1" in said.err
    report = json.loads((in_tmp / "results" / "far" / "report.json").read_text())
    assert (report["outcome"], report["step"]) == ("blew_up", 1)
    assert (in_tmp / "results" / "far" / "series.parquet").is_file()


def settings_of_size(scene: str, size: float) -> Iterator[str]:
    """Each number that a run depends on, alone."""
    config = load_experiment(scene).resolved()
    yield f"h={size}"
    yield from (f"top.{name}={size}" for name, value in config["top"].items() if isinstance(value, float))
    for name, vector in config["initial"].items():
        if name != "gamma":
            yield f"initial.{name}={[size, *vector[1:]] if isinstance(vector, list) else size}"


SIZES = {"a denormal": 5e-324, "tiny": 1e-200, "large": 1e20, "huge": 1e200, "the largest": 1.7e308}
SCENES_OF_SIZES = (*(name for name in scene_files() if name.endswith("_gentle")), "euler_hk")


@pytest.mark.slow
@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("scene", SCENES_OF_SIZES)
def test_runs_with_numbers_of_any_size_end_or_are_refused(cli, scene: str, size: str) -> None:
    """The call fails on a traceback."""
    for number, setting in enumerate(settings_of_size(scene, SIZES[size])):
        said = cli("run", scene, "--set", setting, "--set", "N=3", "--name", f"run{number}")
        assert said.code in (0, 1, 2), setting
        assert "internal error" not in said.err
        assert "Warning" not in said.err


@pytest.mark.slow
def test_init_writes_a_config_that_runs(cli, in_tmp: Path) -> None:
    assert cli("init", "first.yaml").code == 0
    text = (in_tmp / "first.yaml").read_text()
    assert "yaml-language-server: $schema=topcli.schema.json" in text
    schema = json.loads((in_tmp / "topcli.schema.json").read_text())
    assert schema == cli("schema").json()
    assert {"name", "top", "initial", "scheme", "h", "N", "output"} <= set(schema["properties"])
    assert cli("run", "first.yaml", "--set", "N=100").code == 0
    assert cli("init", "first.yaml").code == 2


def test_init_copies_a_scene(cli) -> None:
    assert cli("init", "x.yaml", "--config", "euler_hk").code == 0
    assert cli("run", "x.yaml", "--set", "N=5").code == 0
    assert cli("init", "x.toml", "--config", "kowalevski_torus").code == 0
    assert load_experiment("x.toml").name == "x"
    assert load_experiment("x.toml").digest == load_experiment("kowalevski_torus").digest
    assert "use a name that ends in .yaml" in cli("init", "x.toml").err
    assert "did you mean 'euler_hk'" in cli("init", "y.yaml", "--config", "euler_hh").err


@pytest.mark.slow
def test_python_m_topcli_and_streams(tmp_path: Path) -> None:
    done = topcli_process("run", HK, "--set", "name=kowalevski_hk", "--set", "N=100", "--json", cwd=tmp_path)
    assert done.returncode == 0
    assert json.loads(done.stdout)["runs"][0]["outcome"] == "completed"
    assert done.stderr == ""
    done = topcli_process("run", HK, "--set", "name=kowalevski_hk", "--set", "N=100", cwd=tmp_path)
    assert not {"\x1b", "━"} & set(done.stdout + done.stderr), "neither colours nor boxes in a pipe"


COMPLETED = """
config kowalevski_generic
    kowalevski_generic_hk kowalevski_generic_nodes
top lagr
    lagrange lagrange/inertial
figure work
    work-precision
scheme HK+k
    hk+kahan-li6 hk+kahan-li8
scheme hk+
    hk+kahan-li6 hk+kahan-li8 hk+suzuki4 hk+yoshida4
scheme hybrid+
scheme hk-e
    hk-exact
"""


@pytest.mark.parametrize(("given", "names"), cases_of(COMPLETED))
def test_names_are_completed(given: str, names: list[str], in_tmp: Path) -> None:
    kind, begin = given.split()
    found = getattr(options, f"complete_{kind}")(begin)
    assert set(found) >= {name for line in names for name in line.split()}
    assert bool(found) == bool(names)
    assert all(name.startswith(begin.lower()) for name in found)


@pytest.mark.parametrize("out", ["x" * 300, "/".join(["y" * 200] * 30), "file/r"], ids=["name", "path", "file"])
def test_an_impossible_folder_is_refused_before_computing(
    cli: Callable[..., Said], monkeypatch: pytest.MonkeyPatch, out: str
) -> None:
    Path("file").touch()
    monkeypatch.setattr("topcli.runs.run.drive", None)
    said = cli("run", "kowalevski_hk", "--set", "N=5", "--out", out)
    assert said.code in (1, 2)
    assert len(said.err.splitlines()) == 1
    assert "cannot be" in said.err


def test_windows_is_refused_at_once_naming_wsl(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("topcli.__main__.os.name", "nt")
    with pytest.raises(SystemExit) as leaving:
        main()
    monkeypatch.undo()
    assert leaving.value.code == 2
    err = capsys.readouterr().err
    assert "WSL" in err
    assert len(err.splitlines()) == 1


# motions


def test_infinite_periods_are_shown(cli: Callable[..., Said]) -> None:
    arguments = ("show", "euler_tennis_racket", "--motion", "--set", "top.A=6", "--set", "top.B=4", "--set", "top.C=3")
    arguments += ("--set", "initial.omega=[0.5, 0.25, 1]")
    text = cli(*arguments).out
    assert any(line.split()[:2] == ["period", "∞"] for line in text.splitlines())
    assert cli(*arguments, "--json").json()["motion"]["quantities"]["period"] is None


def test_a_heavy_top_says_that_it_has_no_closed_form(cli: Callable[..., Said]) -> None:
    text = cli("show", "heavy_chaotic", "--motion").out
    title = "heavy_chaotic: no closed form is known for a top with these parameters in these axes"
    assert text.splitlines()[0] == title
    assert [line.split()[0] for line in text.splitlines()[2:]] == ["gamma_sq", "m_gamma", "energy"]
