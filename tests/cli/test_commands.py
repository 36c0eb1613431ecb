"""Commands through their real entry point: what they import, print and write, and how they exit."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from scipy.integrate import solve_ivp

from cases import cases_of
from conftest import ROOT, Said
from custom_tops import VOLTERRA, Y0
from injected import python_process, topcli_process
from resuming import killed
from stored_results import experiment
from topcli import STUDIES, __version__
from topcli.cli.app import COMMANDS, GROUPS, all_commands, command_function
from topcli.cli.options import complete
from topcli.config.files import scene_files
from topcli.config.load import load_experiment
from topcli.errors import ExitCode
from topcli.store.series import read_series

Cli = Callable[..., Said]
HK = str(ROOT / "configs" / "kowalevski_hk.yaml")
HYBRID = str(ROOT / "configs" / "kowalevski_hybrid.yaml")
SHORT = ("--set", "h=0.01", "--set", "T=1")


# what commands import


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
    """A run whose machine code is stored imports neither the compiler nor pandas nor SciPy, nor what others need.

    It starts one process, which asks for the commit, and looks for no plugins of pydantic.
    """
    topcli_process("run", HYBRID, "--set", "N=10", cwd=tmp_path)
    looks = "from pydantic.plugin import _loader; print(set(started) <= {'git'}, _loader._plugins)"
    modules = imported_by(tmp_path, "run", "--force", "-q", "--set", "N=10", HYBRID, after=looks)
    others = "cli.reference cli.results cli.reports studies.report tops.euler tops.lagrange"
    assert not (HEAVY | {f"topcli.{name}" for name in others.split()}) & set(modules)
    assert modules[0] == "True None"


# the table of commands and their options


def test_the_help_lists_every_command_with_its_first_line(cli: Cli) -> None:
    text = cli("--help").out
    places = [text.index(f"\n{title}:\n") for title in GROUPS]
    assert places == sorted(places)
    for name, (_, first_line) in COMMANDS.items():
        assert (command_function(name).__doc__ or "").strip().startswith(first_line)
        assert re.search(rf"^  {name} +{re.escape(first_line)}$", text, re.MULTILINE)
    said = cli()
    assert (said.code, "Run and compare:" in said.out + said.err) == (2, True)


def test_options_mean_the_same_in_all_commands_and_have_a_help() -> None:
    meanings: dict[str, set[tuple[str, ...]]] = {}
    for context in all_commands().values():
        for parameter in context.command.get_params(context):
            assert parameter.param_type_name == "argument" or parameter.help, parameter.name
            if parameter.param_type_name == "option":
                meanings.setdefault(max(parameter.opts, key=len), set()).add((*parameter.opts, parameter.help))
    assert len(meanings) > 40
    assert [name for name, different in meanings.items() if len(different) > 1] == []
    for name in STUDIES:
        assert set(meanings) >= {"--set", "--json", "--plugin"}, name


COMPLETED = """
CONFIG kowalevski_generic
    kowalevski_generic_hk kowalevski_generic_nodes
TOP lagr
    lagrange lagrange/inertial
FIGURE work
    work-precision
SCHEME HK+k
    hk+kahan-li6 hk+kahan-li8
SCHEME hk+
    hk+kahan-li6 hk+kahan-li8 hk+suzuki4 hk+yoshida4
SCHEME hybrid+
SWEEP heavy
    heavy_drift
CONFIG|SCHEME|TOP|FOLDER hk-e
    hk-exact
"""


@pytest.mark.parametrize(("line", "names"), cases_of(COMPLETED))
def test_names_are_completed(line: str, names: list[str], in_tmp: Path) -> None:
    kind, beginning = line.split()
    completed = complete(kind, beginning)
    assert set(completed) >= {name for line in names for name in line.split()}
    assert bool(completed) == bool(names)
    assert all(name.startswith(beginning.lower()) for name in completed)


@pytest.mark.parametrize("name", all_commands())
def test_every_command_loads_a_plugin(cli: Cli, name: str) -> None:
    said = cli(name, "--plugin", "nowhere.py")
    assert (said.code, "plugin nowhere.py: no such file" in said.err) == (2, True)


# runs


def test_a_run_is_written_and_reported(cli: Cli, in_tmp: Path) -> None:
    assert cli("--version").out.startswith(f"topcli {__version__}\nPython ")
    said = cli("run", HYBRID)
    assert (said.code, "completed 50000 steps" in said.err, "verdict" in said.out) == (0, True, True)
    assert (in_tmp / "results" / "kowalevski_hybrid" / "manifest.json").is_file()
    assert "up to date" in cli("run", HYBRID).err
    assert cli("run", HYBRID, "--quiet") == Said(0, "", "")


def test_several_runs_have_titles_one_document_and_one_code(cli: Cli, in_tmp: Path) -> None:
    titles = [line for line in cli("run", HK, HYBRID, *SHORT).out.splitlines() if line.startswith("kowalevski")]
    document = cli("run", HK, HYBRID, *SHORT, "--json").json()
    assert (document["schema_version"], document["command"]) == (1, "run")
    names = [run["name"] for run in document["runs"]]
    assert [name.partition("-")[0] for name in names] == ["kowalevski_hk", "kowalevski_hybrid"]
    assert titles == names
    said = cli("run", "nonsense.yaml", HK, "--set", "N=50")
    assert said.code == 3
    assert "1 of 2 runs succeeded; 1 failed" in said.err
    far = [word for text in ("name=far", "N=50", "h=1e155") for word in ("--set", text)]
    said = cli("run", HK, *far)
    assert (said.code, "blew up at step 1 (t = 1" in said.err) == (1, True)
    assert (in_tmp / "results" / "far" / "series.parquet").is_file()


def test_an_interruption_ends_the_runs_that_follow(cli: Cli, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("topcli.cli.running.code_of_run", lambda _: ExitCode.INTERRUPTED)
    said = cli("run", HK, HYBRID, *SHORT)
    assert (said.code, "0 of 2 runs succeeded; 1 failed; 1 not run" in said.err) == (130, True)


SCENES_OF_SIZES = [*[name for name in scene_files() if name.endswith("_gentle")][1::3], "euler_hk"]


@pytest.mark.slow
@pytest.mark.parametrize("size", [5e-324, 1e20, 1.7e308])
@pytest.mark.parametrize("scene", SCENES_OF_SIZES)
def test_runs_with_numbers_of_any_size_end_or_are_refused(cli: Cli, scene: str, size: float) -> None:
    """Each number that a run depends on, alone; the call fails on a traceback."""
    config = load_experiment(scene).resolved()
    initial = {name: vector for name, vector in config["initial"].items() if name != "gamma"}
    settings = {f"top.{name}": size for name, value in config["top"].items() if isinstance(value, float)}
    settings |= {f"initial.{name}": [size, *v[1:]] if isinstance(v, list) else size for name, v in initial.items()}
    for number, (key, value) in enumerate({"h": size, **settings}.items()):
        said = cli("run", scene, "--set", f"{key}={value}", "--set", "N=3", "--set", f"name=run{number}")
        assert said.code in (0, 1, 2), key
        assert "Warning" not in said.err


@pytest.mark.parametrize("out", ["x" * 300, "/".join(["y" * 200] * 30), "file/r"], ids=["name", "path", "file"])
def test_an_impossible_folder_is_refused_before_computing(cli: Cli, monkeypatch: pytest.MonkeyPatch, out: str) -> None:
    Path("file").touch()
    monkeypatch.setattr("topcli.runs.run.drive", None)
    said = cli("run", HK, "--out", out, *SHORT)
    assert (said.code, said.out, said.err[:7]) == (2, "", "error: ")


# a sweep, its rows and its table


SWEEP = """\
name: study
base: {top: kowalevski, initial: {omega: [0.7, -0.4, 1.3], gamma: [0.6, 0.48, 0.64]}, scheme: rk4, h: 0.01, N: 50}
grid:
  scheme: [hk, rk4]
  h: [0.01, 0.02]
measure: [max_deviation.energy]
"""


@pytest.fixture
def study(in_tmp: Path) -> Path:
    path = in_tmp / "study.yaml"
    path.write_text(SWEEP)
    return path


def rows() -> list[dict[str, object]]:
    return pq.read_table("results/study/rows.parquet").to_pylist()


def test_a_dry_run_lists_the_rows_to_run_and_writes_nothing(cli: Cli, study: Path) -> None:
    lines = cli("sweep", "study.yaml", "--dry-run").out.splitlines()
    assert lines[0] == "study: 4 of 4 rows to run, in results/study"
    assert lines[4] == "row 3: scheme = rk4, h = 0.02"
    for count in (10, 11):
        many = f"grid.h={{from: 1, to: 2, count: {count}}}"
        lines = cli("sweep", "study.yaml", "--dry-run", "--set", many).out.splitlines()
        assert lines[21:] == ["... and 2 more"] * (count == 11)
    assert not Path("results").exists()
    cli("sweep", "study.yaml")
    data = cli("sweep", "study.yaml", "--dry-run", "--json", "--set", "grid.h=[0.02, 0.04]").json()
    new = [{"row": row, "keys": {"scheme": scheme, "h": 0.04}} for row, scheme in ((1, "hk"), (3, "rk4"))]
    assert (data["dry_run"], data["rows"], data["new"], data["to_run"]) == (True, 4, 2, new)


@pytest.mark.slow
def test_a_sweep_and_its_rows_are_shown_and_run_to_the_same_numbers(cli: Cli, study: Path) -> None:
    cli("sweep", "study.yaml", "--set", "base.N=70")
    file, row = cli("show", "results/study"), cli("show", "results/study", "--row", "3")
    Path("row.yaml").write_text(row.out)
    report = cli("run", "row.yaml", "--json").json()["runs"][0]
    (energy,) = [each for each in report["invariants"] if each["name"] == "energy"]
    assert [report[key] for key in ("name", "scheme", "h", "N")] == ["study_3", "rk4", 0.02, 70]
    assert energy["max_deviation"] == rows()[3]["max_deviation.energy"]
    motions = [cli("show", *words, "--motion").out for words in (("row.yaml",), ("results/study", "--row", "3"))]
    assert motions[0].partition(": ")[2] == motions[1].partition(": ")[2] != ""
    study.write_text(file.out)
    assert "(0 ran)" in cli("sweep", "study.yaml").err
    said = cli("run", "kowalevski_hk", "--set", "N=10", "--set", "name=study")
    assert said == Said(2, "", "error: results/study: holds a sweep; choose another name with --set name=NAME\n")


def test_each_number_of_a_result_is_in_its_place(cli: Cli, study: Path) -> None:
    """Of six rows one fails, two are done before, and one is left over: no two numbers are equal."""
    sweep = ["sweep", "study.yaml", "--set", "base.N=500", "--set", "grid.scheme=[rk4]", "--set"]
    cli(*sweep, "grid.h=[0.01, 0.02, 0.07]")
    sweep.append("grid.h=[0.01, 0.02, 0.03, 0.04, 0.05, 9.0]")
    said = cli(*sweep)
    assert (said.code, "error: row 5: blew up at step" in said.err) == (3, True)
    place = Path("results/study/rows.parquet")
    assert f"study: 6 of 6 rows finished; 1 failed -> {place} (4 ran)" in said.err.splitlines()
    assert said.out.split() == ["outcome", "rows", "blew_up", "1", "completed", "5"]
    outcomes = {"blew_up": 1, "completed": 5}
    figures = {"rows": 6, "finished": 6, "ran": 0, "failed": 1, "outcomes": outcomes}
    assert cli(*sweep, "--json").json().items() >= figures.items()
    words = ["--rows", "scheme", "--value", "max_deviation.energy", "--aggregate", "max", "--format", "csv"]
    assert "1 of 6 rows did not complete: 1 blew_up" in cli("table", "study", *words).err
    many = "grid.h={from: 9, to: 20, count: 30}"
    said = cli("sweep", "study.yaml", "--set", many, "--set", "grid.scheme=[rk4]", "--set", "base.N=500")
    assert (said.err.count("error: row "), said.err.count("further failures are only counted")) == (20, 1)
    assert said.code == 1, "no row completed"


# a top of fifteen lines of YAML, and a plugin with a top and a scheme, in all commands


def exact(t: float, k: float = 0.3) -> np.ndarray:
    """State at t by an integration of equations written here."""

    def rates(_, w):
        return [(w[1] * w[2] - k * w[1]) / 3.0, (-2.0 * w[2] * w[0] + k * w[0]) / 2.0, w[0] * w[1]]

    return solve_ivp(rates, (0.0, t), Y0, method="DOP853", rtol=1e-13, atol=1e-15).y[:, -1]


@pytest.mark.slow
def test_an_own_top_agrees_with_an_independent_integration(cli: Cli, in_tmp: Path) -> None:
    Path("v.yaml").write_text(VOLTERRA)
    schemes = ["hk", "midpoint", "rk4"]
    tables = cli("compare", *schemes, "--config", "v.yaml", "--json").json()["tables"]
    assert [row["scheme"] for row in tables[0]["rows"]] == schemes
    for row in tables[0]["rows"]:
        name = row["scheme"]
        assert cli("run", "v.yaml", "--set", f"scheme={name}", "--set", f"name={name}").code == 0
        series = read_series(Path("results") / name / "series.parquet")
        error = np.linalg.norm(np.array([series[w][-1] for w in ("w1", "w2", "w3")]) - exact(4.0))
        assert row["final_error"] == pytest.approx(error, rel=1e-3)
    t = np.linspace(0.0, 4.0, 41)
    states = np.array([[time, *(exact(time) if time else Y0)] for time in t])
    np.savetxt("other.csv", states, delimiter=",", header="t,w1,w2,w3", comments="")
    judged = cli("analyse", "other.csv", "--config", "v.yaml", "--json").json()["tables"][0]["rows"]
    assert {row["figure"]: row["value"] for row in judged}["max error"] < 1e-11


# show, list, init


def test_a_top_is_described_by_what_it_declares_and_what_its_field_says(cli: Cli) -> None:
    lines = cli("show", "weierstrass").out.splitlines()
    assert {"v' = 6*x**2 - 1.5", "degree of the equations: 2"} <= {*lines}
    for top in cli("show", "Euler", "--json").json()["tops"]:
        assert top["parameters"]["A"]["value"] == 3.0
        assert top["degree"] == 2
        assert {"hk", "midpoint"} <= set(top["schemes"])
    assert "; conserved where m_gamma = 0" in " ".join(cli("show", "goryachev-chaplygin").out.split())


def test_generated_code_can_be_read_and_run(cli: Cli) -> None:
    """The code of Kahan's step of v' = 6 x^2 - g2/2, x' = v, against its defining equations."""
    code = cli("show", "hk", "--top", "weierstrass", "--source").out
    scope: dict = {"fma": lambda a, b, c: a * b + c}
    exec(code, scope)
    h, x, v = 0.1, 0.3, -0.2
    p = [3.0, *(eval(line.partition(" = ")[2]) for line in code.splitlines() if line.startswith("# p["))]
    new_x, new_v = scope["step"]((x, v), h, p)
    assert (new_x - x) / h == pytest.approx((v + new_v) / 2, rel=1e-14)
    assert (new_v - v) / h == pytest.approx(6 * x * new_x - 1.5, rel=1e-14)


def test_a_motion_is_shown_with_what_has_no_value(cli: Cli) -> None:
    asymptotic = [f"top.{name}={value}" for name, value in (("A", 6), ("B", 4), ("C", 3))]
    words = [word for text in (*asymptotic, "initial.omega=[0.5, 0.25, 1]") for word in ("--set", text)]
    text = cli("show", "euler_tennis_racket", "--motion", *words).out
    assert any(line.split()[:2] == ["period", "∞"] for line in text.splitlines())
    json_ = cli("show", "euler_tennis_racket", "--motion", *words, "--json").json()
    assert json_["motion"]["quantities"]["period"] is None
    text = cli("show", "heavy_chaotic", "--motion").out
    assert text.startswith("heavy_chaotic: no closed form is known for a top with these parameters in these axes\n")


def test_runs_are_listed_with_sweeps(cli: Cli, study: Path) -> None:
    assert cli("list", "runs").err == "no runs in results\n"
    cli("run", "euler_hk", *SHORT, "--set", "name=one", "--quiet")
    cli("sweep", "study.yaml", "--quiet")
    items = cli("list", "runs", "--json").json()["runs"]
    keys = ("name", "kind", "outcome", "step", "N")
    assert [[item[key] for key in keys] for item in items] == [
        ["one", "run", "completed", 100, 100],
        ["study", "sweep", "completed", 4, 4],
    ]
    header, first, *_ = (line.split() for line in cli("list", "runs").out.splitlines())
    assert header == ["name", "kind", "outcome", "step", "N", "scheme", "h", "ended"]
    assert first[:7] == ["one", "run", "completed", "100", "100", "hk", "0.01"]
    page = cli("report", "one", "results/one", "--out", "page.html", "--json").json()
    assert [result["name"] for result in page["results"]] == ["one"]


@pytest.mark.slow
def test_init_copies_a_scene_that_runs(cli: Cli, in_tmp: Path) -> None:
    assert cli("init", "first.yaml").code == 0
    assert "yaml-language-server: $schema=topcli.schema.json" in (in_tmp / "first.yaml").read_text()
    schema = json.loads((in_tmp / "topcli.schema.json").read_text())
    assert schema == cli("schema").json()
    assert {"name", "top", "initial", "scheme", "h", "N", "output"} <= set(schema["properties"])
    assert cli("run", "first.yaml", "--set", "N=100").code == 0
    assert cli("init", "x.toml", "--config", "kowalevski_torus", "--force").code == 0
    assert load_experiment("x.toml").name == "x"
    assert load_experiment("x.toml").digest == load_experiment("kowalevski_torus").digest
    assert "use a name that ends in .yaml" in cli("init", "y.toml").err
    assert "did you mean 'euler_hk'" in cli("init", "y.yaml", "--config", "euler_hh").err


# files that exist, and stored results by name


WRITERS = {
    "report": "report short --out mine.html",
    "animate": "animate turning --out mine.gif --seconds 0.2",
    "init": "init mine.yaml",
    "compare": "compare hk --save mine.json",
    "figure": "compare hk --set h=0.01 --set T=1 --plot mine.svg",
    "plot": "plot fig1 --format svg --out .",
}
"""A command that writes a file, by a name for it."""


@pytest.fixture
def stored(cli: Cli, in_tmp: Path) -> Cli:
    """Call a command in a folder with a run, a run with attitudes and a sweep."""
    assert cli("run", "euler_hk", *SHORT, "--set", "name=short", "-q").code == 0
    assert cli("run", "euler_attitude", "--set", "N=50", "--set", "name=turning", "-q").code == 0
    study = "name: swept\nbase: {top: euler, initial: {omega: [1, 0.5, 0.2]}, h: 0.1, N: 10}\n"
    (in_tmp / "swept.yaml").write_text(study + "grid: {scheme: [hk, rk4]}\nmeasure: [max_error]\n")
    assert cli("sweep", "swept.yaml", "-q").code == 0
    return cli


@pytest.mark.slow
@pytest.mark.parametrize("name", WRITERS)
def test_a_file_of_somebody_else_is_kept(name: str, stored: Cli, in_tmp: Path) -> None:
    words = WRITERS[name].split()
    before = {path for path in in_tmp.iterdir() if path.is_file()}
    assert stored(*words, "-q") == Said(0, "", "")
    written = sorted({path for path in in_tmp.iterdir() if path.is_file()} - before)
    assert written
    for path in written:
        path.write_text("mine")
    said = stored(*words, "-q")
    assert (said.code, said.out) == (2, "")
    assert said.err.endswith("exists already; choose another name or folder, or use --force to replace it\n")
    assert {path.read_text() for path in written} == {"mine"}
    assert stored(*words, "--force", "-q") == Said(0, "", "")
    assert "mine" not in {path.read_bytes().decode(errors="replace") for path in written}


@pytest.mark.slow
@pytest.mark.parametrize(
    "line",
    [
        "verify short",
        "report swept --out page.html",
        "table swept --rows scheme --value max_error",
        "animate turning --out turning.gif --seconds 0.2",
        "plot sweep swept --x scheme --y max_error --out pictures",
        "show swept --row 1",
    ],
)
def test_a_stored_result_is_found_by_name_or_path(line: str, stored: Cli, in_tmp: Path) -> None:
    force = ["--force"] if "--out" in line else []
    (in_tmp / "results").rename(in_tmp / "elsewhere")
    by_name = stored(*line.split(), "--results", "elsewhere", *force)
    assert by_name.code == 0, by_name.err
    name = line.split()[2 if line.startswith("plot") else 1]
    by_path = stored(*line.replace(name, f"elsewhere/{name}", 1).split(), *force)
    assert (by_path.code, by_path.out) == (0, by_name.out)
    missing = stored(*line.replace(name, "nowhere", 1).split(), *force)
    assert (missing.code, "nowhere" in missing.err) == (2, True)


def test_no_page_is_written_on_an_unfinished_run(cli: Cli, in_tmp: Path, small_chunks: None) -> None:
    killed(in_tmp / "results", experiment("long", N=5000), 3)
    said = cli("report", "long", "--out", "page.html")
    assert (said.code, "unfinished" in said.err, (in_tmp / "page.html").exists()) == (2, True, False)
