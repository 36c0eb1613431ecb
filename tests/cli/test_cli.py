"""The command line through its real entry point: what it prints, what it writes, how it leaves."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from conftest import ROOT
from injected import Operations, command_in_fork, signal_to_self
from topcli import __version__

CONFIGS = ROOT / "configs"
HK = str(CONFIGS / "kowalevski_hk.yaml")
HYBRID = str(CONFIGS / "kowalevski_hybrid.yaml")


def process(*arguments: str, cwd: Path, **options) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "topcli", *arguments],
        capture_output=True,
        text=True,
        cwd=cwd,
        check=False,
        **options,
    )


def test_version_and_help(cli) -> None:
    assert cli("--version").out == f"topcli {__version__}\n"
    said = cli("--help")
    assert said.code == 0
    for command in ("run", "compare", "plot", "list", "show", "init", "schema", "doctor"):
        assert command in said.out


def test_help_imports_no_heavy_package(tmp_path: Path) -> None:
    """``topcli --help`` imports none of the costly packages."""
    code = (
        "import sys; sys.argv = ['topcli', '--help']\n"
        "from topcli.__main__ import main\n"
        "try: main()\n"
        "except SystemExit: pass\n"
        "heavy = {'numpy', 'numba', 'scipy', 'pandas', 'matplotlib', 'pyarrow', 'pydantic', 'ruamel.yaml'}\n"
        "print(sorted(heavy & set(sys.modules)), file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=tmp_path, check=True)
    assert done.stderr.strip() == "[]"


@pytest.mark.slow
def test_warm_run_is_light(tmp_path: Path) -> None:
    """A run whose machine code is known imports neither the compiler nor pandas nor SciPy, nor what others need.

    It starts one process, which asks for the commit, and looks for no plugins of pydantic.
    """
    process("run", HYBRID, "--set", "N=10", cwd=tmp_path)
    code = (
        "import subprocess, sys; sys.argv = ['topcli', 'run', '--force', '-q', '--set', 'N=10', sys.argv[1]]\n"
        "started, init = [], subprocess.Popen.__init__\n"
        "def noted(self, args, *more, **options): started.append(args[0]); init(self, args, *more, **options)\n"
        "subprocess.Popen.__init__ = noted\n"
        "from topcli.__main__ import main\n"
        "try: main()\n"
        "except SystemExit: pass\n"
        "heavy = {'numba', 'scipy', 'pandas', 'matplotlib', 'numpy.polynomial', 'rich'}\n"
        "others = 'cli.bench cli.inspect cli.plot cli.study config.ensemble studies.study tops.euler tops.lagrange'\n"
        "unused = heavy | {f'topcli.{name}' for name in others.split()}\n"
        "print(sorted(unused & set(sys.modules)), file=sys.stderr)\n"
        "from pydantic.plugin import _loader\n"
        "print(set(started) <= {'git'}, _loader._plugins, file=sys.stderr)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, HYBRID], capture_output=True, text=True, cwd=tmp_path, check=True
    )
    assert done.stderr.splitlines() == ["[]", "True None"]


def test_run_writes_and_reports(cli, in_tmp: Path) -> None:
    said = cli("run", HYBRID)
    assert said.code == 0
    assert "completed 50000 steps" in said.err
    assert "verdict" in said.out
    assert (in_tmp / "results" / "kowalevski_hybrid" / "manifest.json").is_file()
    assert "up to date" in cli("run", HYBRID).err


def test_the_papers_own_figures_for_hk(cli) -> None:
    """k² between 9.000003 and 9.000011, as the paper reports."""
    report = cli("run", HK, "--json").json()["runs"][0]
    k_sq = next(row for row in report["invariants"] if row["name"] == "k_sq")
    assert f"{k_sq['min']:.6f}" == "9.000003"
    assert f"{k_sq['max']:.6f}" == "9.000011"
    assert k_sq["verdict"] == "bounded"


def test_the_hybrid_is_exact_where_it_says_so(cli) -> None:
    report = cli("run", HYBRID, "--json").json()["runs"][0]
    verdicts = {row["name"]: row["verdict"] for row in report["invariants"]}
    assert verdicts["gamma_sq"] == verdicts["k_sq"] == "exact"
    assert "exact" not in (verdicts["two_l"], verdicts["energy"])


@pytest.mark.slow
def test_json_is_one_document(cli) -> None:
    said = cli("run", HK, HYBRID, "--set", "N=100", "--json")
    document = said.json()
    assert document["schema_version"] == 1
    assert [run["name"].partition("-")[0] for run in document["runs"]] == ["kowalevski_hk", "kowalevski_hybrid"]


def test_set_is_validated_after_the_override(cli, in_tmp: Path) -> None:
    assert cli("run", HK, "--set", "h=0.01", "--set", "N=200", "--set", "name=mine", "--quiet").code == 0
    manifest = json.loads((in_tmp / "results" / "mine" / "manifest.json").read_text())
    assert (manifest["config"]["h"], manifest["config"]["N"]) == (0.01, 200)
    said = cli("run", HK, "--set", "h=0")
    assert said.code == 2
    assert "h" in said.err
    assert [path.name for path in (in_tmp / "results").iterdir()] == ["mine"]


def test_quiet_says_nothing(cli) -> None:
    said = cli("run", HK, "--set", "N=50", "--quiet")
    assert (said.code, said.out, said.err) == (0, "", "")


def test_dry_run_writes_nothing(cli, in_tmp: Path) -> None:
    said = cli("run", HK, HYBRID, "--dry-run")
    assert said.code == 0
    assert "50001 rows" in said.out
    assert list(in_tmp.iterdir()) == []


def test_one_failure_does_not_stop_the_other_runs(cli, in_tmp: Path) -> None:
    said = cli("run", "nonsense.yaml", HK, "--set", "N=50")
    assert said.code == 3
    assert list((in_tmp / "results").glob("kowalevski_hk-??????"))
    assert "1 of 2 runs succeeded; 1 failed" in said.err
    said = cli("run", "nonsense.yaml", HYBRID, "--set", "N=50", "--fail-fast")
    assert said.code == 2
    assert not list((in_tmp / "results").glob("kowalevski_hybrid*"))


def test_blow_up_is_reported_and_its_rows_kept(cli, in_tmp: Path) -> None:
    said = cli(
        "run",
        HK,
        "--name",
        "kowalevski_hk",
        "--set",
        "initial.omega=[1e200, 1e200, 1e200]",
        "--set",
        "h=1.0",
        "--set",
        "N=50",
    )
    assert said.code == 1
    assert "blew up at step 1 (t = 1)" in said.err
    report = json.loads((in_tmp / "results" / "kowalevski_hk" / "report.json").read_text())
    assert (report["outcome"], report["step"]) == ("blew_up", 1)
    assert (in_tmp / "results" / "kowalevski_hk" / "series.parquet").is_file()


@pytest.mark.parametrize("command", ["run", "show"])
def test_packaged_scenes_by_name(cli, command: str) -> None:
    assert cli(command, "kowalevski-hybrid", "--set", "N=20").code == 0


def test_show_is_loadable(cli, in_tmp: Path) -> None:
    shown = cli("show", HYBRID, "--set", "initial.gamma=[-auto, 0.6, 0]").out
    (in_tmp / "again.yaml").write_text(shown)
    assert cli("show", "again.yaml").out == shown
    assert cli("show", HYBRID, "--json").json()["config"]["scheme"]["name"] == "hybrid"


def test_init_writes_a_config_that_runs(cli, in_tmp: Path) -> None:
    assert cli("init", "first.yaml").code == 0
    text = (in_tmp / "first.yaml").read_text()
    assert "yaml-language-server: $schema=topcli.schema.json" in text
    assert json.loads((in_tmp / "topcli.schema.json").read_text())["type"] == "object"
    assert cli("run", "first.yaml", "--set", "N=100").code == 0
    said = cli("init", "first.yaml")
    assert said.code == 2
    assert "exists already" in said.err
    assert (in_tmp / "first.yaml").read_text() == text


def test_doctor_finds_this_machine_well(cli) -> None:
    found = cli("doctor", "--json").json()
    assert found["cache"]["kept between processes"] is True
    assert found["environment"]["topcli"] == __version__
    assert found["problems"] == []
    assert "python" in cli("doctor").out


def test_schema_is_json_schema(cli) -> None:
    schema = json.loads(cli("schema").out)
    assert schema["$schema"].startswith("https://json-schema.org/")
    assert {"name", "top", "initial", "scheme", "h", "N", "output"} <= set(schema["properties"])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("run", "configs/nowhere.yaml"), ("nowhere.yaml",)),
        (("run", "kowalevski_hkk"), ("kowalevski_hk",)),
        (("run", HK, "--set", "scheme=hkk"), ("hkk", "did you mean 'hk'")),
        (("run", HK, "--set", "top.kind=kowalewski"), ("kowalewski", "kowalevski")),
        (("run", HK, "--format", "xlsx"), ("format", "parquet")),
        (("compare", "hk", "hybird"), ("hybird", "hybrid")),
        (("compare", "hk", "HK"), ("twice",)),
        (("plot", "fig9"), ("fig9", "did you mean 'fig")),
        (("plot",), ("--all",)),
        (("plot", "fig1", "--format", "gif"), ("gif", "png")),
        (("list", "schemes", "--top", "kovalevski"), ("kowalevski",)),
        (("run", HK, "--scheme-file", "nowhere.py"), ("nowhere.py", "no such file")),
        (("init", "x.ini"), ("x.ini", ".yaml")),
        (("run", HK, "--set", "name=figures"), ("figures", "pictures")),
        (("compare", "hk", "--set", "scheme=hybrid"), ("scheme=hybrid", "command line")),
        (("compare", "hk", "hybrid", "--set", "scheme.brunch=sign"), ("brunch", "branch")),
        (("plot", "fig1", "--all"), ("either names of figures or --all",)),
    ],
)
def test_mistakes_take_at_most_three_lines(
    cli, in_tmp: Path, arguments: tuple[str, ...], words: tuple[str, ...]
) -> None:
    said = cli(*arguments)
    assert said.code == 2
    assert said.out == ""
    assert len(said.err.strip().splitlines()) <= 3
    for word in words:
        assert word in said.err
    assert list(in_tmp.iterdir()) == []


@pytest.mark.slow
def test_python_m_topcli_and_streams(tmp_path: Path) -> None:
    done = process("run", HK, "--name", "kowalevski_hk", "--set", "N=100", "--json", cwd=tmp_path)
    assert done.returncode == 0
    assert json.loads(done.stdout)["runs"][0]["outcome"] == "completed"
    assert done.stderr == ""
    done = process("run", HK, "--name", "kowalevski_hk", "--set", "N=100", cwd=tmp_path)
    assert not {"\x1b", "━"} & set(done.stdout + done.stderr), "neither colours nor boxes in a pipe"


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="POSIX signals")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_interruption_keeps_what_was_written(tmp_path: Path, number: signal.Signals) -> None:
    """A signal at the third checkpoint of a run that would take days."""
    steps = ["--set", "N=1000000000000", "--set", "output.every=100000", "--checkpoint-every", "0"]
    at_a_checkpoint = Operations(tmp_path, 3, signal_to_self(number), names=["replace"], only="checkpoint")
    said = command_in_fork(["run", HK, "--name", "kowalevski_hk", *steps, "--quiet"], tmp_path, at_a_checkpoint)
    assert said.code == 130, said.err
    assert "Traceback" not in said.err
    manifest = json.loads((tmp_path / "results" / "kowalevski_hk" / "manifest.json").read_text())
    assert manifest["outcome"] == "interrupted"
    assert 0 < manifest["step"] < 10**10


@pytest.mark.slow
@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ("topcli compare hy", "hybrid"),
        ("topcli plot fi", "fig3"),
        ("topcli list schemes --top ko", "kowalevski"),
    ],
)
def test_shell_completion(tmp_path: Path, words: str, expected: str) -> None:
    done = subprocess.run(
        [sys.executable, "-c", "from topcli.__main__ import main; main()"],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        env={
            **os.environ,
            "_TOPCLI_COMPLETE": "complete_bash",
            "COMP_WORDS": words,
            "COMP_CWORD": str(len(words.split()) - 1),
        },
        check=False,
    )
    assert expected in done.stdout.split()


def test_dry_run_refuses_what_run_refuses(cli) -> None:
    cli("run", HK, "--name", "kowalevski_hk", "--set", "N=50", "--quiet")
    assert "up to date" in cli("run", HK, "--name", "kowalevski_hk", "--set", "N=50", "--dry-run").out
    said = cli("run", HK, "--dry-run")
    assert said.code == 2
    assert "holds a different experiment" in said.err
    assert "the existing different run is renamed" in cli("run", HK, "--dry-run", "--force").out


@pytest.mark.parametrize(
    ("changed", "named"),
    [
        (("h=0.1",), ["h: 0.001 there, 0.1 here"]),
        (("scheme=hybrid", "h=0.002"), ["scheme.name: hk there, hybrid here", "h: 0.001 there, 0.002 here"]),
        (("top.c0=2",), ["top.c0: 1.0 there, 2.0 here"]),
        (("output.every=5",), ["output.every: 1 there, 5 here"]),
        (("ensemble.random={count: 2, gamma: sphere}",), ["ensemble.random.count: nothing there, 2 here"]),
    ],
)
def test_another_experiment_of_a_name_is_told_by_the_keys_that_differ(cli, changed, named) -> None:
    words = ("run", HK, "--name", "same", "--set", "N=50", "--quiet")
    assert cli(*words).code == 0
    said = cli(*words, *(word for text in changed for word in ("--set", text)))
    assert said.code == 2
    first, advice = said.err.splitlines()
    assert first.startswith("error: results/same: holds a different experiment (")
    assert first.endswith("); nothing was written")
    for text in named:
        assert text in first
    assert "digest" not in first
    assert advice.startswith("choose another name with --name")


@pytest.mark.slow
def test_options_reach_every_scheme_that_has_them(cli) -> None:
    said = cli("compare", "hk", "hybrid", "bohlin-a", "--set", "scheme.branch=sign", "--set", "N=100", "--json")
    changed = {scheme["scheme"]: scheme["changed"] for scheme in said.json()["schemes"]}
    assert changed == {"hk": {}, "hybrid": {"branch": "sign"}, "bohlin-a": {"branch": "sign"}}


def test_an_unwritable_folder_is_refused_before_computing(cli, in_tmp: Path) -> None:
    (in_tmp / "file").write_text("")
    for arguments in (("compare", "hk", "--plot"), ("plot", "fig1")):
        said = cli(*arguments, "--out", "file")
        assert said.code == 2
        assert "--out" in said.err
    assert [path.name for path in in_tmp.iterdir()] == ["file"]


def test_init_does_not_overwrite_a_file_of_the_users(cli, in_tmp: Path) -> None:
    (in_tmp / "topcli.schema.json").write_text("mine")
    assert cli("init", "first.yaml").code == 2
    assert (in_tmp / "topcli.schema.json").read_text() == "mine"
    assert not (in_tmp / "first.yaml").exists()


def test_tables_of_several_runs_have_titles(cli) -> None:
    out = cli("run", HK, HYBRID, "--set", "N=100").out
    assert out.splitlines()[0].startswith("kowalevski_hk-")
    assert any(line.startswith("kowalevski_hybrid-") for line in out.splitlines())


@pytest.mark.slow
@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full here")
def test_unusable_stdout_is_not_reported_as_a_bug(tmp_path: Path) -> None:
    with open("/dev/full", "w") as full:
        done = subprocess.run(
            [sys.executable, "-m", "topcli", "show", HK], stdout=full, stderr=subprocess.PIPE, text=True, check=False
        )
    assert done.returncode == 1
    assert "cannot write to standard output" in done.stderr
    assert "Traceback" not in done.stderr
    environment = {**os.environ, "PYTHONIOENCODING": "ascii"}
    done = process("run", HK, "--name", "kowalevski_hk", "--set", "N=50", cwd=tmp_path, env=environment)
    assert done.returncode == 0, done.stderr


@pytest.mark.slow
def test_broken_pipe_gives_no_traceback(tmp_path: Path) -> None:
    done = subprocess.run(
        f"{sys.executable} -m topcli schema | head -n 1",
        shell=True,
        capture_output=True,
        text=True,
        cwd=tmp_path,
        check=False,
    )
    assert "Traceback" not in done.stderr
    assert done.stdout.startswith("{")
