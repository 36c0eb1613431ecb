"""Mistakes in a command: exit code 2, up to three lines that say what is wrong and what to do, and nothing written."""

from __future__ import annotations

import shlex
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from cases import cases_of
from conftest import ROOT, Said
from documentation import read_page
from stored_results import store_run, store_sweep

pytestmark = pytest.mark.slow

Cli = Callable[..., Said]
SWEEP = """\
name: study
base: {top: kowalevski, initial: {omega: [0.7, -0.4, 1.3], gamma: [0.6, 0.48, 0.64]}, scheme: rk4, h: 0.01, N: 50}
grid:
  h: [0.01, 0.02]
measure: [max_deviation.energy]
"""
SCHEME = """\
import topcli
@topcli.scheme({name}, top={top}, title="t", order=1, explicit=True, self_adjoint=True, citation="c", equations="e")
def build(top, options):
    {docstring}
"""
FILES = {
    **read_page(ROOT / "docs" / "own-scheme.md").files(),
    "study.yaml": SWEEP,
    "file.txt": "x",
    "old.html": "x",
    "none.json": "x",
    "other.json": '{"command": "nothing"}',
    "empty.py": "x = 1\n",
    "taken.py": SCHEME.format(name="'hk'", top="'kowalevski'", docstring="'''One.'''"),
    "misspelt.py": SCHEME.format(name="'my'", top="'kowalewski'", docstring="'''One.'''"),
    "undocumented.py": SCHEME.format(name="'my'", top="'kowalevski'", docstring="pass"),
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Files of a user, a stored run and a stored sweep."""
    made = tmp_path_factory.mktemp("work")
    for name, text in FILES.items():
        (made / name).write_text(text)
    store_run(made / "results", "mine", N=60)
    store_sweep(made / "results", "swept")
    (made / "bare").mkdir()
    (made / "bare.html").mkdir()
    np.savetxt(made / "mine.csv", np.eye(4), delimiter=",", header="time,w_x,w_y,w_z", comments="")
    return made


@pytest.fixture
def refused(cli: Cli, folder: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[str], str]:
    """Message of a command in the folder, which must refuse."""

    def call(command: str) -> str:
        monkeypatch.chdir(folder)
        before = sorted(folder.rglob("*"))
        said = cli(*shlex.split(command))
        assert (said.code, said.out) == (2, "")
        assert said.err.startswith("error: ")
        assert len(said.err.strip().splitlines()) <= 3
        assert sorted(folder.rglob("*")) == before
        return said.err

    return call


MISTAKES = """
rnu
    error: no such command 'rnu'; did you mean 'run'? (see topcli --help)
discover results/mine
    error: no such command 'discover'; topcli integrability finds the integrals of a map
run
    error: missing argument 'CONFIG' (see topcli run --help)
run kowalevski_hk --thread 2
    error: no such option: --thread; did you mean --threads? (see topcli run --help)
run kowalevski_hk --sett h=1
    error: no such option: --sett; did you mean --set? (see topcli run --help)
list scheems
    error: no such command 'scheems'; did you mean 'schemes' or 'scenes' or 'sweeps'? (see topcli list --help)
animate euler_attitude --out a.gif
    no such file or folder, and no run of this name in results; run it first: topcli run euler_attitude
table heavy_drift --rows scheme --value drift.energy
    run it first: topcli sweep heavy_drift
run kowalevski_hk --out
    error: option '--out' requires an argument
schema x
    error: got unexpected extra argument(s) (x) (see topcli schema --help)
run configs/nowhere.yaml
    nowhere.yaml
run kowalevski_hkk
    kowalevski_hk
run zzz
    `topcli list scenes` lists them
run results/mine
    its config is results/mine/config.yaml
run kowalevski_hk --set scheme=hkk
    did you mean 'hk'
run kowalevski_hk --set top.kind=kowalewski
    kowalewski
    kowalevski
run kowalevski_hk --set name=figures
    name: 'figures' cannot name a folder
run kowalevski_hk --set h=0
    h: must not be zero
run kowalevski_hk --format csv
    error: no such option: --format; use --set output.format=csv
run kowalevski_hk --set output.format=xlsx
    format
    parquet
run minee.yaml
    minee.yaml: no such file
run kowalevski_hk --resume
    error: no such option: --resume
run kowalevski_hk --checkpoint-every nan
    must be a number of seconds
run kowalevski_hk --name mine
    error: no such option: --name; use --set name=NAME
run kowalevski_hk --set 'name=""'
    name: '' cannot name a folder
run kowalevski_hk --plugin nowhere.py
    nowhere.py
    no such file
run kowalevski_hk --plugin empty.py
    registers nothing
run kowalevski_hk --plugin taken.py
    already registered by topcli
run kowalevski_hk --plugin misspelt.py
    did you mean 'kowalevski'
run kowalevski_hk --plugin undocumented.py
    has no docstring
run rotor.yaml --plugin gyrostat.py --set scheme=dmv
    use a scheme that needs the field alone, such as rk4
compare hk hybird
    unknown scheme 'hybird'; did you mean 'hybrid'
compare hk HK
    twice
compare hk+suzuki4 HK+suzuki4
    twice
compare hk bohlin-a+suzuki4
    not self-adjoint
compare hk --set scheme=hybrid
    --set scheme=hybrid: name schemes and their options as arguments
compare hk hybrid --set scheme.brunch=sign
    --set scheme.brunch=sign: name schemes
compare hk kowalevski_hk
    topcli compare hk hybrid --config kowalevski_hk
compare hk --plot --out file.txt
    --out
plot
    --all
plot fig1 --all
    either names of figures or --all
plot fig9
    unknown figure 'fig9'; did you mean 'fig4'
plot fig1 --format gif
    gif
    png
plot fig1 --set h=0.01
    error: no such option: --set; figures draw packaged scenes; for other values, use topcli run and topcli report
plot kowalevski_hk
    is a config, not a figure; run it with `topcli run kowalevski_hk`
plot swept
    with: topcli plot sweep results/swept --x KEY --y MEASURE
show mine
    show its config with: topcli show results/mine
show FIG1
    is a figure; draw it with: topcli plot fig1
run lagrange_hk --set scheme=bs
    scheme 'bs' does not fit top 'lagrange'
    lagrange/inertial
show hkk
    did you mean 'hk'?
show zzz
    see `topcli list scenes` and `topcli list schemes`
show kowalevski_hk --set scheme=hkk
    unknown scheme 'hkk'; did you mean 'hk'?
show study.yaml --motion
    this is a sweep, but an experiment is needed here
show . --motion
    --motion: needs a single experiment, not a sweep
show results
    results: is not the folder of a sweep
show results/swept --row 6
    has no row 6; it has 6
list schemes --top kovalevski
    kowalevski
list runs --results nowhere
    error: --results nowhere: no such folder
init study.yaml
    exists already
cite kowalewski
    did you mean 'kowalevski'
claims hybrid-reversable
    unknown claim 'hybrid-reversable'; did you mean 'hybrid-reversible'
order hk --h fine
    invalid value for '--h'
order hk --top euler
    error: no such option: --top; give --config CONFIG
stress dg5
    error: unknown scheme 'dg5'; known: dop853, hk
stress --case dleone
    did you mean 'delone'?
stress hk-exact --top kowalevski
    it fits euler
stress hybrid --set scheme.brunch=sign
    did you mean 'branch'?
stress hybrid --case pole --set scheme.branch=odd
    nearest
stress --case sleeping --top gyrostat --plugin gyrostat.py
    unknown case 'sleeping' of gyrostat
analyse mine.csv --config euler_hk
    mine.csv: no columns t, omega1, omega2, omega3; known: time, w_x, w_y, w_z; --rename t=COLUMN names it
analyse mine.csv --config euler_hk --rename t=time,omega1=w_x,omega2=w_y,omega3=w_z,omega4=x
    unknown name 'omega4'; did you mean
analyse mine.csv --config euler_hk --steps 0
    error: --steps 0: must be at least 1
analyse mine.csv --config euler_ensemble
    ensemble
sweep study.yaml --set measure=[max_deviation.l]
    error: --set measure=[max_deviation.l]: measure: unknown measure 'max_deviation.l'
sweep study.yaml --dask local:2 --threads 3
    error: --threads cannot be used with --dask; each worker has its own number
sweep study.yaml --dask nowhere
    error: --dask nowhere: no scheduler can be reached
sweep study.yaml --yes
    error: no such option: --yes; a sweep of any size runs without it
table swept --results nowhere --rows h --value max_error
    no such file or folder, and no run of this name in nowhere; did you mean results/swept?
table results/swept --rows h --value error
    error: --value: unknown measure 'error'; did you mean 'max_error'?
table results/swept --rows schem --value max_error
    error: --rows and --columns: unknown key 'schem'; did you mean 'scheme'?
table results/swept --rows h --value max_error --aggregate avg
    error: --aggregate 'avg': unknown; known: max, mean, median, order
table results/swept --rows h --value max_error --format latx
    error: --format 'latx': unknown format; did you mean 'latex'?
table results/swept --rows scheme --value max_error --where h=7
    error: --where 'h=7': no row has this value; h is one of: 0.04, 0.02, 0.01
table results/swept --rows h --value max_error
    error: up to 2 values fall into one cell, because scheme still varies
table results/swept --rows h --columns scheme --value max_error --out file.txt
    exists already
report minee --out page.html
    error: 'minee': no such file or folder, and no run of this name in results; did you mean 'mine'?
report results --out page.html
    error: results: no run is stored here (manifest.json is missing); give one of the runs in it, such as results/
report none.json --out page.html
    error: none.json: not a result of a study: not JSON: Expecting value: line 1 column 1 (char 0)
report mine --out page.pdf
    error: --out page.pdf: unknown type of page; use a name ending in .html
report mine --out bare --force
    .html
table results/swept --rows h --value max_error --value max_deviation.energy --columns scheme
    the columns show a single --value; 2 are given
table results/swept --rows h --value max_error --value max_error
    measure 'max_error' is named twice
init new.yaml --scheme hybrid
    error: no such option: --scheme; copy a scene with --config SCENE, and edit it
run kowalevski_hk --set output.attitude=quaternion --set precision=50
    output.attitude: cannot be combined with precision
run kowalevski_ensemble --set output.attitude=quaternion
    output.attitude: cannot be combined with ensemble
sweep study.yaml --set base.output.attitude=quaternion
    output.attitude: cannot be in base
run kowalevski_hk --set name=a/b
    name: 'a/b' cannot name a folder
report mine --out old.html
    error: --out old.html: exists already; choose another name or folder, or use --force to replace it
cite hk+kahan
    did you mean 'kahan-li
integrability euler midpoint
    error: integrability: scheme 'midpoint' cannot compute with rational functions: it solves its equations by iteration
integrability kowalevski hybrid
    error: integrability: scheme 'hybrid' cannot compute with rational functions: it uses math.sqrt
integrability euler --config kowalevski_hk
    kowalevski_hk is of the top 'kowalevski', not 'euler'
integrability custom
    a custom top is declared in a config
lax euler --config euler_ensemble
    ensemble: this is an ensemble of 243 trajectories
sweep results/mine/config.yaml
    this is an experiment; `topcli run` takes experiments
sweep heavy_drif
    no packaged sweep is called 'heavy_drif'
    did you mean 'heavy_drift'
"""


@pytest.mark.parametrize(("command", "messages"), cases_of(MISTAKES))
def test_a_mistake_is_answered_in_words(refused: Callable[[str], str], command: str, messages: list[str]) -> None:
    said = refused(command)
    assert [message for message in messages if message not in said] == []
