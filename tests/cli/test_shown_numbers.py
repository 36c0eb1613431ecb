"""A number shown equals the number stored: every cell of every table against its field in ``--json``.

Studies are measured once; then each of their numbers is replaced by one of its own, so that two swapped columns or
fields cannot look alike. The fields that the cells under a heading must show are written here, beside the headings.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator, Sequence
from datetime import datetime
from pathlib import Path
from typing import Any

import pytest

import topcli
from conftest import Said
from shown import STRESS_TRIALS, cells_of, cells_under, distinct, field, named_differently, shows
from stored_results import BASE
from terminal import in_terminal
from topcli.config.files import scene_files, sweep_files
from topcli.figures.catalogue import FIGURES
from topcli.runs.report import ENSEMBLE, INVARIANTS, report_markdown
from topcli.schemes.compose import COMPOSITIONS
from topcli.schemes.registry import all_schemes
from topcli.studies import find_study
from topcli.studies.bench import measure as bench
from topcli.studies.bench.result import DECADE_TABLE, POINT_TABLE
from topcli.studies.stress.cases import CASES
from topcli.studies.stress.study import FAILURES, QUESTIONS, TRIALS, grid_of, printed
from topcli.studies.study import Result
from topcli.table import Table
from topcli.tops import TOPS

Cli = Callable[..., Said]
Columns = Sequence[tuple[str, str | Callable[[Any], Any]]]
"""Headings, each with the paths of the fields that its cells show, or a function of the row that returns the values."""
Expected = tuple[Sequence[Any], Columns]
"""Rows of a table, and its columns."""


def columns_of(text: str) -> list[tuple[str, Any]]:
    """Columns from lines of a heading and the paths of its fields, with a colon between them."""
    return [(head, paths) for head, _, paths in (line.rpartition(": ") for line in text.strip("\n").split("\n"))]


def assert_shows(table: Table, data: Any, rows: Sequence[Any], columns: Columns) -> None:
    """The table has just these headings over these rows, and its cells show their values."""
    texts = table.cells(data)
    lines = [texts.header or [""] * len(texts.lines[0]), *texts.lines]
    heads, *shown = zip(*lines, strict=True) if table.across else lines
    assert list(heads) == [head for head, _ in columns]
    for row, cells in zip(rows, shown, strict=True):
        for (head, of), cell in zip(columns, cells, strict=True):
            values = of(row) if callable(of) else [field(row, path) for path in of.split()]
            values = values if any(value is not None for value in values) else [None]
            assert shows(cell, *values), (head, cell, values)


SETTINGS: dict[str, tuple[Any, ...]] = {
    "compare": (("hk", "hybrid", "exact"), {"config": "kowalevski_hk", "overrides": ["N=3000"]}),
    "compare modified": (("hk", "bs", "rk4"), {"config": "euler_hk", "overrides": ["N=3000"]}),
    "lax": (("euler", "hk", "bs"), {"overrides": ["N=40"]}),
    "lax discrete": (("kowalevski", "hk", "backlund"), {"overrides": ["N=40"]}),
    "order": (("hk", "rk4", "dg4"), {"steps": 2000, "duration": 4.0}),
    "roundoff": (("hk", "euler_hk"), {"steps": 300, "copies": 2}),
}
"""Arguments of the Python function of a study."""
KEPT = ("h", "N", "power", "steps", "copies", "declared_order", "duration")
NAMED = ("verdict", "model", "steps_from")


def distinct_data(data: Any) -> Any:
    """Plain data with a number of its own in each place, and verdicts that are told apart."""
    return named_differently(distinct(json.loads(json.dumps(data)), 1, keep=KEPT), NAMED)


def compared(data: Any) -> Iterator[Expected]:
    """A line for each figure, a column for each entry."""
    schemes, first, reference = data["schemes"], data["schemes"][0], data["reference"]
    columns = columns_of(": label\noutcome: outcome\nmax error: max_error\nfinal error: final_error")
    figures = columns_of("""
max deviation of %s: max_deviation
drift of %s per unit time: drift
standard error of the drift of %s: drift_error
model of %s: model
verdict of %s: verdict
""")
    for i, row in enumerate(first["invariants"]):
        columns += [(head.replace("%s", row["symbol"]), f"invariants.{i}.{key}") for head, key in figures]
    for name, known in {row["name"]: row for scheme in schemes for row in scheme["modified"]}.items():

        def of(scheme: Any, *paths: str, name: str = name) -> list[Any]:
            (row,) = [row for row in scheme["modified"] if row["name"] == name] or [None]
            return [field(row, path) for path in paths] if row else [None]

        def correction(scheme: Any, of: Any = of) -> list[Any]:
            if not scheme["modified"]:
                return [None]
            size, coefficient, power = (of(scheme, f"correction.{key}")[0] for key in ("size", "coefficient", "power"))
            return [size, coefficient, {1: "h", 2: "h²"}.get(power, f"h^{power}")]

        columns.append((f"max deviation of {known['symbol']}", lambda scheme, of=of: of(scheme, "max_deviation")))
        columns.append((f"verdict of {known['symbol']}", lambda scheme, of=of: of(scheme, "verdict")))
        if "correction" in known:
            columns.append((f"{known['symbol']} less {known['correction']['of']}, at most", correction))
    closed = ", of a closed form per state" if any(scheme["closed_form"] for scheme in schemes) else ""
    columns.append((f"reversal defect at h = {first['h']:g}", "reversal_defect"))
    columns.append(("order of the reversal defect", lambda scheme: [scheme["reversal_order"] or "round-off"]))
    columns.append((f"first swing spacing of {reference['swing']}", "first_swing_spacing"))
    columns.append((f"ns per step{closed}", "nanoseconds_per_step"))
    columns.append(("compile or load, s", "compile_seconds"))
    yield schemes, columns


def lax_forms(data: Any) -> Iterator[Expected]:
    """A column for each form; then a line for each scheme, with the drifts of each form's spectrum."""
    forms = [
        {
            **form,
            "shape": f"{form['size']}x{form['size']}",
            "trace": {"block": "block traces of L^k"}.get(form["form"], "tr L^k"),
            "carried": ", ".join(form["carries"]) or "–",
            "pair": {True: "yes", False: "no"}[form["lax_pair"]],
            "order": form["midpoint"]["order"] or "round-off",
        }
        for form in data["forms"]
    ]
    yield (
        forms,
        columns_of("""
: form
size: shape
dL/dt - [M,L] by the equations: residual_by_field
dL/dt - [M,L] by differences: residual_by_differences
traces: trace
independent integrals: independent_integrals
carried integrals: carried
Lax pair: pair
midpoint rule: L' - U L U^-1: midpoint.conjugation_defect
  its order in h: order
"""),
    )
    columns: list[tuple[str, str]] = [("", "scheme")]
    for i, form in enumerate(forms):
        columns.append((f"{form['form']}: {form['trace']}", f"forms.{i}.drift"))
        columns.append((f"{form['form']}: eigenvalues", f"forms.{i}.eigenvalue_shift"))
    discrete = [("L'U - UL", "discrete_lax_defect")] if "backlund" in [run["scheme"] for run in data["runs"]] else []
    yield data["runs"], columns + discrete


def orders(data: Any) -> Iterator[Expected]:
    """The order and the smallest error of each scheme, and all errors at each step size."""
    schemes = data["schemes"]
    rows = []
    for row in schemes:
        errors = {point["error"]: point["h"] for point in row["points"]}
        ends = {"fit": row["fitted"][0], "end": row["fitted"][-1]} if row["fitted"] else {"fit": None, "end": None}
        rows.append({**row, **ends, "error": min(errors), "at": errors[min(errors)]})
    yield (
        rows,
        columns_of("""
scheme: scheme
declared order: declared_order
observed: order
verdict: verdict
h of the fit: fit end
round-off: plateau
from h: onset
smallest error: error
at h: at
"""),
    )
    sizes = sorted({point["h"] for row in schemes for point in row["points"]}, reverse=True)
    points = {(row["scheme"], point["h"]): point["error"] for row in schemes for point in row["points"]}
    rows = [{"h": h, **{row["scheme"]: points.get((row["scheme"], h)) for row in schemes}} for h in sizes]
    yield rows, [(name, name) for name in rows[0]]


def roundoffs(data: Any) -> Iterator[Expected]:
    """The forms of the sums together for each invariant."""
    count = len(data["forms"][0]["invariants"])
    yield (
        [{**form, **form["invariants"][i]} for i in range(count) for form in data["forms"]],
        columns_of("""
invariant: symbol
sums: form
drift (rms): drift
largest: max_drift
exponent: exponent exponent_error
growth: verdict
bias per step: bias bias_error
ns/step: nanoseconds_per_step
cost: cost
"""),
    )


EXPECTED = {"compare": compared, "lax": lax_forms, "order": orders, "roundoff": roundoffs}


@pytest.mark.slow
@pytest.mark.parametrize("case", SETTINGS)
def test_every_cell_of_a_study_is_the_value_of_its_field(case: str) -> None:
    name = case.partition(" ")[0]
    schemes, options = SETTINGS[case]
    data = distinct_data(getattr(topcli, name)(*schemes, **options).as_dict())
    if name == "order":  # of three schemes one has no plateau to show
        for row in data["schemes"][1:]:
            row |= {"plateau": 1.5e-13 * len(row["points"]), "onset": 1.25e-3 * len(row["points"])}
    tables = find_study(name).tables_of(data)
    for table, (rows, columns) in zip(tables, EXPECTED[name](data), strict=True):
        assert_shows(table, data, rows, columns)


@pytest.mark.slow
def test_a_command_prints_the_tables_and_the_data_of_its_study(cli: Cli) -> None:
    command = ("lax", "euler", "hk", "--set", "N=40")
    report = topcli.lax("euler", "hk", overrides=["N=40"])
    long = in_terminal([sys.executable, "-m", "topcli", *command, "-v"], Path.cwd(), 300)[1]
    printed = [line.split() for line in long.splitlines()]
    for table in find_study("lax").tables_of(report.as_dict()):
        texts = table.cells(report.as_dict())
        assert all(" ".join(line).split() in printed for line in (texts.header, *texts.lines))
    assert cli(*command, "--json").json() == report.as_dict()


INVARIANT_COLUMNS = columns_of("""
invariant: symbol
first value: first
min: min
max: max
max deviation: max_deviation
max deviation, relative: max_deviation_relative
rms deviation: rms_deviation
rms deviation, relative: rms_deviation_relative
drift per unit time: drift
standard error of the drift: drift_error
95 % bound of the drift: drift_bound
drift over the run: drift_over_run
model: model
round-off bound: round_off_bound
verdict: verdict
""")


def test_runs_and_ensembles_show_the_report_that_they_stored(tmp_path: Path) -> None:
    run = distinct_data(topcli.run(BASE, tmp_path, scheme="hk", name="one", progress=False).result.report)
    assert_shows(INVARIANTS, run, run["invariants"], INVARIANT_COLUMNS)
    header, ruler, *marked = (line for line in report_markdown(run).splitlines() if line.startswith("|"))
    assert set(ruler) <= set("| -")
    before_table = report_markdown(run).partition("\n|")[0]
    assert [line for line in before_table.splitlines() if line.startswith("- ")] == [
        f"- {row['symbol']}: **{row['statement']}**" for row in run["invariants"]
    ]
    texts = INVARIANTS.cells(run)
    cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in (header, *marked)]
    assert cells == [list(texts.header), *map(list, texts.lines)]
    many = {"ensemble": {"random": {"count": 9, "gamma": "sphere"}}, "N": 50}
    ensemble = topcli.run({**BASE, **many}, tmp_path, scheme="hk", name="many", progress=False)
    invariants = distinct_data(ensemble.result.report["invariants"])
    quantiles = ENSEMBLE.cells({"invariants": invariants})
    (head, *symbols), within, *lines = quantiles.header, *quantiles.lines
    assert (head, symbols) == ("invariant", [row["symbol"] for row in invariants])
    assert within[0] == "within round-off"
    for cell, row in zip(within[1:], invariants, strict=True):
        assert shows(cell, row["within_round_off"], row["judged"])
    titles = {"max deviation": "max_deviation", "rms deviation": "rms_deviation"}
    titles["final deviation"] = "final_deviation"
    shown = [(titles[line[0].partition(", ")[0]], line[0].partition(", ")[2]) for line in lines]
    every = [(title, quantile) for title in titles.values() for quantile in invariants[0]["max_deviation"]]
    assert shown == [(title, q) for title, q in every if title == "max_deviation" or q in ("median", "max")]
    for (_, *cells), (key, quantile) in zip(lines, shown, strict=True):
        assert all(shows(cell, row[key][quantile]) for cell, row in zip(cells, invariants, strict=True))


@pytest.mark.parametrize("swings", [3, 7])
def test_an_analysis_shows_what_it_measured(tmp_path: Path, swings: int) -> None:
    run = topcli.run("euler_hk", tmp_path, progress=False)
    data = distinct_data(topcli.analyse(run.folder / "series.parquet", "euler_hk").as_dict())
    swing = data["swing"]
    swing["times"] = [1.25 * i + 0.5 for i in range(swings)]
    summary, invariants = find_study("analyse").tables_of(data)
    assert summary.title_of(data) == f"{data['file']}: {data['top_title']}"
    texts = dict(summary.cells(data).lines)
    period, _, kind = texts.pop("times").partition(", ")
    assert shows(period, data["t_first"], data["t_last"])
    assert kind == data["times"]
    assert texts.pop("steps") == f"{data['steps']} ({data['steps_from']})"
    listed, _, more = texts.pop(f"minima of {swing['component']}").partition(" and ")
    assert [float(time) for time in listed.split(", ")] == swing["times"][:5]
    assert more == ("2 more" if swings == 7 else "")
    assert shows(texts.pop("their first spacing"), swing["first_swing_spacing"], swing["reference_first_swing_spacing"])
    expected = {"rows": data["rows"], "reference from": "the config's initial state", "max error": data["max_error"]}
    expected |= {"first row − config": data["reference"]["difference"], "final error": data["final_error"]}
    assert all(shows(texts.pop(head), value) for head, value in expected.items())
    assert not texts
    assert_shows(invariants, data, data["invariants"], INVARIANT_COLUMNS)


def test_a_benchmark_shows_what_it_measured() -> None:
    entry = {"name": "hk", "setting": "h=0.5", "seconds": 1.0}
    pair = {"topcli": entry, "peer": {**entry, "name": "rk4", "setting": "h=0.25"}}
    decades = [{"error": error, **pair, "ratio": 1.0, "baseline_ratio": 1.0} for error in (1e-3, 1e-4)]
    point = {"value": 0.5, "seconds": 1.0, "quartiles": [1.0, 1.0], "error": 1.0, "final_error": 1.0, "drift": 1.0}
    competitors = [{"name": name, "kind": "topcli", "parameter": "h", "points": [point, point]} for name in "ab"]
    data = {"decades": distinct(decades, 2, keep=("error",)), "competitors": distinct(competitors, 3, keep=("value",))}
    rows = [
        {**row, "µs": [1e6 * row[kind]["seconds"] for kind in ("topcli", "peer")], "rounded": rounded}
        for row in data["decades"]
        for rounded in [[float(f"{row[key]:.2g}") for key in ("ratio", "baseline_ratio")]]
    ]
    decade_columns = columns_of("""
error: error
best topcli: topcli.name
with: topcli.setting
µs: µs.0
best peer: peer.name
with: peer.setting
µs: µs.1
ratio: rounded.0
over scipy: rounded.1
""")
    assert_shows(DECADE_TABLE, data, rows, decade_columns)
    points = [
        {**one, **point, "setting": "h=0.5", "µs": [1e6 * x for x in (point["seconds"], *point["quartiles"])]}
        for one in data["competitors"]
        for point in one["points"]
    ]
    point_columns = columns_of("""
: name
with: setting
µs per unit time: µs.0
quartiles: µs.1 µs.2
max error: error
at the end: final_error
largest drift: drift
""")
    assert_shows(POINT_TABLE, data, points, point_columns)


def test_a_benchmark_prints_its_closed_forms_and_points(cli: Cli, monkeypatch: pytest.MonkeyPatch) -> None:
    form = {"name": "exact", "error": 3.4e-15, "seconds_per_state": 7.8e-6, "states": 321, "setup_seconds": 0.25}
    measured = bench.bench
    monkeypatch.setattr(bench, "bench", lambda *given, **more: {**measured(*given, **more), "closed_forms": [form]})
    command = "bench hk --scene lagrange --against none --budget 0.001 --repetitions 1 --points"
    out = " ".join(cli(*command.split()).out.split())
    words = "3.40e-15, 7.8 µs a state over 321 states, after a set-up of 0.25 s"
    assert f"in closed form, exact: distance from the reference {words}" in out
    assert ": every point with µs per unit time quartiles" in out


def test_trials_in_hard_cases_are_shown_with_their_verdicts() -> None:
    words = {"ok": "", "limit": "declared limit"}
    rows = []
    for one in STRESS_TRIALS["trials"]:
        step = "" if one["step"] is None else f" at step {one['step']}"
        word = words.get(one["verdict"], one["verdict"])
        loud = {"unexplained": "UNDECLARED", "outlived limit": "DECLARED AS A LIMIT"}.get(one["verdict"], word)
        what = one["outcome"] + step + (f", {loud}" if loud else "")
        rows.append({**one, "what": what, "word": word})
    shared = "scheme: scheme\ntop: top\ncase: case\n"
    assert_shows(TRIALS, STRESS_TRIALS, rows, columns_of(f"{shared}outcome: what\nwhy: why"))
    failed = [one for one in rows if one["outcome"] in ("degraded", "broke") or one["verdict"] != "ok"]
    columns = columns_of(f"{shared}outcome: outcome\nstep: step\nwhy: why\nverdict: word")
    assert_shows(FAILURES, STRESS_TRIALS, failed, columns)
    columns = columns_of("case: case\ntop: top\nquestion: question")
    assert_shows(QUESTIONS, STRESS_TRIALS, STRESS_TRIALS["cases"], columns)


def test_the_grid_of_hard_cases_shows_each_outcome() -> None:
    """A sign for each scheme and case, in the column of the case, and their meanings in the caption."""
    signs = {"held": "·", "degraded": "o", "broke": "X", "not tried": "–"}
    outcomes = {(one["scheme"], one["case"]): one["outcome"] for one in STRESS_TRIALS["trials"]}
    cases, texts = [one["case"] for one in STRESS_TRIALS["cases"]], grid_of(STRESS_TRIALS, "kowalevski")
    shown = texts.cells(STRESS_TRIALS)
    assert shown.header == ["scheme", *cases]
    assert shown.lines == [
        [name, *(signs[outcomes[name, case]] for case in cases)] for name in dict.fromkeys(name for name, _ in outcomes)
    ]
    assert all(f"{sign} {outcome}" in shown.caption for outcome, sign in signs.items())


def test_many_trials_are_printed_as_the_cases_of_each_outcome_by_name() -> None:
    """Schemes with the same outcomes share a row; what contradicts a declaration is said beside the case."""
    more = [
        {**one, "scheme": name, "case": f"{one['case']}{i}"}
        for i in range(5)
        for one in STRESS_TRIALS["trials"]
        for name in ([one["scheme"], "twin"] if one["scheme"] == "hk" else [one["scheme"]])
    ]
    many = {**STRESS_TRIALS, "trials": more}
    said, summary = printed(Result(many), verbose=False)
    assert said == (
        "60 trials: 3 held, 2 degraded, 2 broke, 1 not tried; 10 at declared limits; "
        "10 contradict what the schemes declare"
    )
    assert isinstance(summary, Table)

    def five(case: str, verdict: str = "") -> str:
        return ", ".join(f"{case}{i}{verdict}" for i in range(5))

    cells = summary.cells(many)
    assert cells.header == ["scheme", "held", "degraded", "broke", "not tried"]
    assert cells.lines == [
        ["hk, twin", "5", five("delone"), five("huge"), five("rest")],
        ["rk4", "10", five("huge"), five("pole", " (UNDECLARED)"), "–"],
    ]
    for data, verbose in ((STRESS_TRIALS, False), (many, True)):
        assert list(printed(Result(data), verbose=verbose))[1:] == [TRIALS]


REGISTERED: dict[str, tuple[str, Callable[[], Sequence[Any]]]] = {
    "schemes": (
        "name top title order explicit self_adjoint conserves equations citation origin limits",
        lambda: all_schemes(),
    ),
    "tops": ("form title components citation", lambda: list(TOPS.values())),
    "compositions": ("name order stages weights title citation", lambda: list(COMPOSITIONS.values())),
    "cases": ("name question", lambda: CASES),
    "figures": ("name title", lambda: list(FIGURES.values())),
}
LISTS = (*REGISTERED, "scenes", "sweeps", "measures", "runs")


@pytest.mark.slow
@pytest.mark.parametrize("kind", LISTS)
def test_a_list_shows_its_items_and_they_have_the_fields_of_what_is_registered(cli: Cli, kind: str) -> None:
    if kind == "runs":
        for name in ("kowalevski_hk", "euler_hk"):
            cli("run", name, "--set", "N=30", "--quiet")
    code, printed = in_terminal([sys.executable, "-m", "topcli", "list", kind], Path.cwd(), 80)
    header, _, *lines = printed.splitlines()
    assert code == 0
    items = cli("list", kind, "--json").json()[kind]
    keys = {head: "form" if (kind, head) == ("tops", "top") else head.replace("-", "_") for head in cells_of(header)}
    for line, item in zip(lines, items, strict=True):
        cells = dict(zip(keys, cells_under(header, line) if kind == "figures" else cells_of(line), strict=True))
        for head, key in keys.items():
            match value := item[key]:
                case bool():
                    assert cells[head] == ("yes" if value else "no")
                case list():
                    assert cells[head] == (", ".join(value) or "–")
                case dict():  # a parameter that follows from others has no default
                    parts = [name if part is None else f"{name} = {part:g}" for name, part in value.items()]
                    assert cells[head] == (", ".join(parts) or "–")
                case int() | float():
                    assert float(cells[head]) == pytest.approx(value, rel=1e-5)
                case _ if key == "ended":
                    ended = datetime.fromisoformat(value).astimezone()
                    assert cells[head] == ended.strftime("%Y-%m-%d %H:%M")
                case _:
                    assert cells[head] == (value or "–")
    if kind in ("scenes", "sweeps"):
        files = scene_files() if kind == "scenes" else sweep_files()
        assert [item["name"] for item in items] == list(files)
        assert all(item["about"] for item in items)
    fields, registered = REGISTERED.get(kind, ("", lambda: items))
    for item, one in zip(items, registered(), strict=True):
        assert {key: item[key] for key in fields.split()} == json.loads(
            json.dumps({key: getattr(one, key) for key in fields.split()}, default=dict)
        )
