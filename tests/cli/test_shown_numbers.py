"""A number shown equals the number stored: every cell of every printed table against its field in ``--json``.

Studies are measured once; then each of their numbers is replaced by one of its own, so that two swapped columns or
fields cannot look alike. What a cell shows is read from its text.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from shown import cells_of, cells_under, changed_result, distinct, named_differently, shows, table_of
from topcli.studies import analyse, compare, lax, order, roundoff
from topcli.studies.bench import measure as bench


def expect(row: list[str], label: str, values: list[tuple[Any, ...]]) -> None:
    """The row has this label, and its cells show these values."""
    assert row[0] == label
    assert len(row) == len(values) + 1, row
    for cell, shown in zip(row[1:], values, strict=True):
        assert shows(cell, *shown), (label, cell, shown)


@pytest.mark.parametrize(
    ("config", "names"), [("kowalevski_hk", ("hk", "hybrid", "exact")), ("euler_hk", ("hk", "bs", "rk4"))]
)
def test_compare_shows_what_it_measured(
    cli: Callable[..., Any], monkeypatch: pytest.MonkeyPatch, config: str, names: tuple[str, ...]
) -> None:
    def change(found: Any) -> Any:
        figures = distinct(found.data, 1, keep=("power", "h", "N", "every"))
        return dataclasses.replace(found, data=named_differently(figures, ("verdict", "model")))

    monkeypatch.setattr(compare, "compare_schemes", changed_result(change, compare.compare_schemes))
    command = ("compare", *names, "--config", config, "--set", "N=3000")
    rows = table_of(cli(*command).out.partition("\n")[2], "hk")
    found = cli(*command, "--json").json()
    schemes = found["schemes"]
    assert rows.pop(0) == list(names)
    lines = iter(rows)

    def line(label: str, *paths: Callable[[Any], Any]) -> None:
        expect(next(lines), label, [tuple(path(scheme) for path in paths) for scheme in schemes])

    line("outcome", lambda s: s["outcome"])
    line("max error", lambda s: s["max_error"])
    line("error at the end", lambda s: s["end_error"])
    for i, row in enumerate(schemes[0]["invariants"]):
        line(f"{row['symbol']} max deviation", lambda s, i=i: s["invariants"][i]["max_deviation"])
        line(f"{row['symbol']} drift per unit time", lambda s, i=i: s["invariants"][i]["drift"])
        line("its standard error", lambda s, i=i: s["invariants"][i]["drift_error"])
        line("model", lambda s, i=i: s["invariants"][i]["model"])
        line("verdict", lambda s, i=i: s["invariants"][i]["verdict"])
    assert bool(expect_modified(lines, schemes)) == (config == "euler_hk")
    label, *cells = next(lines)
    assert shows(label.removeprefix("reversal defect at h = "), schemes[0]["reversal"]["h"])
    expect(["defect", *cells], "defect", [(s["reversal"]["defect"],) for s in schemes])
    line("its order in h", lambda s: "round-off" if s["reversal"]["order"] is None else s["reversal"]["order"])
    label, *cells = next(lines)
    spacing = found["reference"]["swing_spacing"]
    assert spacing is None or shows(label.partition("reference ")[2].rstrip(")"), spacing)
    expect(["spacing", *cells], "spacing", [(s["swing_spacing"],) for s in schemes])
    evaluated = ", of a closed form per state" if "exact" in names else ""
    line(f"ns per step{evaluated}", lambda s: s["nanoseconds_per_step"])
    line("compile or load, s", lambda s: s["compile_seconds"])
    if config == "kowalevski_hk":
        assert schemes[-1]["setup_seconds"] is not None
        line("set-up, s", lambda s: s["setup_seconds"])
    (note,) = next(lines)
    assert note.endswith(f" from the {found['reference']['method']}.")
    assert next(lines, None) is None


def expect_modified(lines: Iterator[list[str]], schemes: list[Any]) -> dict[str, Any]:
    """The integrals of the schemes themselves, whose lines come next."""
    modified = [{row["name"]: row for row in scheme["modified"]} for scheme in schemes]
    known = {name: row for rows in modified for name, row in rows.items()}
    for name, row in known.items():
        having = [rows.get(name) for rows in modified]
        expect(next(lines), f"{row['symbol']} max deviation", [(one and one["max_deviation"],) for one in having])
        expect(next(lines), "verdict", [(one and one["verdict"],) for one in having])
        if "correction" in row:
            label, *cells = next(lines)
            assert label == f"less {row['correction']['of']}, at most"
            for cell, one in zip(cells, having, strict=True):
                expect_correction(cell, one and one["correction"])
    return known


def expect_correction(cell: str, terms: dict[str, Any] | None) -> None:
    """The largest difference between the two integrals, and its coefficient of a power of h."""
    if terms is None:
        assert cell == "–"
        return
    size, _, product = cell.partition(" = ")
    coefficient, power = product.split()
    assert shows(size, terms["size"])
    assert shows(coefficient, terms["coefficient"])
    assert power == {1: "h", 2: "h²"}.get(terms["power"], f"h^{terms['power']}")


def test_roundoff_shows_what_it_measured(cli: Callable[..., Any], monkeypatch: pytest.MonkeyPatch) -> None:
    def change(found: Any) -> Any:
        return named_differently(distinct(found, 2, keep=("steps", "copies")), ("verdict",))

    monkeypatch.setattr(roundoff, "roundoff_study", changed_result(change, roundoff.roundoff_study))
    command = ("roundoff", "hk", "--config", "euler_hk", "--steps", "300", "--copies", "2")
    rows = table_of(cli(*command).out, "invariant")[1:]
    forms = cli(*command, "--json").json()["forms"]
    assert [form["form"] for form in forms] == ["plain", "compensated"]
    count = len(forms[0]["invariants"])
    pairs = [(form, form["invariants"][i]) for i in range(count) for form in forms]
    for row, (form, one) in zip(rows, pairs, strict=True):
        shown = [
            (form["form"],),
            (one["drift"],),
            (one["max_drift"],),
            (one["exponent"], one["exponent_error"]),
            (one["verdict"],),
            (one["bias"], one["bias_error"]),
            (form["nanoseconds_per_step"],),
            (form["cost"],),
        ]
        expect(row, one["symbol"], shown)


def test_order_shows_what_it_measured(cli: Callable[..., Any], monkeypatch: pytest.MonkeyPatch) -> None:
    def change(found: Any) -> Any:
        sizes = {one["h"] for row in found["schemes"] for one in row["points"]}
        first, *others = found["schemes"]
        with_plateau = {**found, "schemes": [first, *(row | {"plateau": 1.0, "onset": 1.0} for row in others)]}
        new = distinct(with_plateau, 5, keep=("declared_order", "duration", "h"))
        return {**new, "schemes": [row | {"fitted": [float(h) for h in row["fitted"]]} for row in new["schemes"]]} | (
            {"sizes": sorted(sizes)}
        )

    monkeypatch.setattr(order, "order_study", changed_result(change, order.order_study))
    command = ("order", "hk", "rk4", "dg4", "--steps", "2000", "--duration", "4")
    title, out = cli(*command).out.split("\n", 1)
    found = cli(*command, "--json").json()
    schemes = found["schemes"]
    assert title == f"{found['name']}: {found['top']}, t from 0 to 4"
    rows = table_of(out, "scheme")
    assert rows.pop(0) == [
        "scheme",
        "order",
        "observed",
        "verdict",
        "fitted over h",
        "round-off",
        "from h",
        "smallest error",
        "at h",
    ]
    for row, one in zip(rows, schemes, strict=True):
        best = min(one["points"], key=lambda point: point["error"])
        fitted = (one["fitted"][0], one["fitted"][-1]) if one["fitted"] else (None,)
        judged = [(one["declared_order"],), (one["order"],), (one["verdict"],)]
        values = [*judged, fitted, (one["plateau"],), (one["onset"],)]
        expect(row, one["scheme"], [*values, (best["error"],), (best["h"],)])
    header, *lines = out.partition("largest error at each h\n")[2].splitlines()
    assert cells_of(header) == ["h", "hk", "rk4", "dg4"]
    assert len(lines) == len(found["sizes"])
    for line, h in zip(lines, reversed(found["sizes"]), strict=True):
        shown, *cells = cells_of(line)
        assert shows(shown, h)
        for cell, one in zip(cells, schemes, strict=True):
            error = [point["error"] for point in one["points"] if point["h"] == h]
            assert shows(cell, *error) if error else cell == "–"


@pytest.mark.parametrize(("top", "schemes"), [("euler", ("hk", "bs")), ("kowalevski", ("hk", "backlund"))])
def test_lax_shows_what_it_measured(
    cli: Callable[..., Any], monkeypatch: pytest.MonkeyPatch, top: str, schemes: tuple[str, ...]
) -> None:
    def change(found: Any) -> Any:
        return distinct(found, 3)

    monkeypatch.setattr(lax, "lax_study", changed_result(change, lax.lax_study))
    command = ("lax", top, *schemes, "--set", "N=40")
    out = cli(*command).out
    found = cli(*command, "--json").json()
    forms, names = found["forms"], [form["form"] for form in found["forms"]]
    assert len(forms) > 1
    rows = table_of(out.partition("\n")[2], names[0])
    assert rows.pop(0) == names
    assert [row[0] for row in rows] == [
        "size",
        "dL/dt - [M,L] by the equations",
        "dL/dt - [M,L] by differences",
        "traces",
        "independent integrals",
        "carried integrals",
        "Lax pair",
        "midpoint rule: L' - U L U^-1",
        "its order in h",
    ]
    paths: list[Callable[[Any], Any]] = [
        lambda f: f"{f['size']}x{f['size']}",
        lambda f: f["residual_by_field"],
        lambda f: f["residual_by_differences"],
        lambda f: {"block": "block traces of L^k"}.get(f["form"], "tr L^k"),
        lambda f: f["independent_integrals"],
        lambda f: ", ".join(f["carries"]) or "–",
        lambda f: {True: "yes", False: "no"}[f["lax_pair"]],
        lambda f: f["midpoint"]["conjugation_defect"],
        lambda f: "round-off" if f["midpoint"]["order"] is None else f["midpoint"]["order"],
    ]
    for row, path in zip(rows, paths, strict=True):
        expect(row, row[0], [(path(form),) for form in forms])
    below = out.partition("largest relative drift of the spectrum of L\n")[2].splitlines()
    header = [f"{form['form']}: {kind}" for form in forms for kind in (form["traces"], "eigenvalues")]
    discrete = ["L'U - UL"] if top == "kowalevski" else []
    assert cells_of(below[0]) == header + discrete
    for line, run in zip(below[1:], found["runs"], strict=True):
        assert [form["form"] for form in run["forms"]] == names
        values = [(form[key],) for form in run["forms"] for key in ("drift", "eigenvalue_shift")]
        expect(cells_of(line), run["scheme"], values + [(run["discrete_lax_defect"],) for _ in discrete])


def test_bench_shows_what_it_measured(cli: Callable[..., Any], monkeypatch: pytest.MonkeyPatch) -> None:
    def change(found: Any) -> Any:
        entry = {"name": "rk4", "setting": "h=0.5", "parameter": "h", "value": 0.5, "seconds": 1.0}
        decades = [
            row | {"topcli": entry | {"name": "hk"}, "peer": entry, "ratio": 1.0, "baseline_ratio": 1.0}
            for row in found["decades"]
        ]
        kept = ("schema_version", "duration", "intervals", "goal", "value")
        points = distinct({**found, "decades": [row | {"error": str(row["error"])} for row in decades]}, 4, keep=kept)
        points["decades"] = [row | {"error": float(row["error"])} for row in points["decades"]]
        points["closed_forms"] = [
            {"name": "exact", "error": 3.4e-15, "seconds_per_state": 7.8e-6, "states": 321, "setup_seconds": 0.25}
        ]
        for i, row in enumerate(points["decades"]):
            row["topcli"]["setting"], row["peer"]["setting"] = f"h=0.{i + 1}", f"h={i + 1}"
        return points

    monkeypatch.setattr(bench, "bench", changed_result(change, bench.bench))
    command = ("bench", "hk", "rk4", "--scene", "lagrange", "--against", "none", "--budget", "0.001", "--points")
    out = cli(*command, "--repetitions", "1").out
    (scene,) = cli(*command, "--repetitions", "1", "--json").json()["scenes"]
    rows = table_of(out, "error")
    assert rows.pop(0) == ["error", "best topcli", "with", "µs", "best peer", "with", "µs", "ratio", "over scipy"]
    for row, decade in zip(rows, scene["decades"], strict=True):
        assert float(row[0]) == decade["error"]
        for cells, entry in ((row[1:4], decade["topcli"]), (row[4:7], decade["peer"])):
            expect(cells, entry["name"], [(entry["setting"],), (1e6 * entry["seconds"],)])
        assert shows(row[7], decade["ratio"], rounded=2)
        assert shows(row[8], decade["baseline_ratio"], rounded=2)
    (form,) = scene["closed_forms"]
    distance, _, time = out.partition("in closed form, exact: distance from the reference ")[2].partition(", ")
    assert shows(distance, form["error"])
    time, _, setup = time.partition(" µs a state over 321 states, after a set-up of ")
    assert shows(time, 1e6 * form["seconds_per_state"])
    assert shows(setup.partition(" s")[0], form["setup_seconds"])
    below = out.partition("every point\n")[2].splitlines()
    header = ["with", "µs per unit time", "quartiles", "max error", "at the end", "largest drift"]
    assert cells_of(below[0]) == header
    points = [(one, point) for one in scene["competitors"] for point in one["points"]]
    for line, (one, point) in zip(below[1:], points, strict=False):
        _, setting, *cells = cells_of(line)
        assert setting.startswith(f"{one['parameter']}=")
        expect(
            [one["name"], *cells],
            one["name"],
            [
                (1e6 * point["seconds"],),
                tuple(1e6 * quartile for quartile in point["quartiles"]),
                (point["error"],),
                (point["end_error"],),
                (point["drift"],),
            ],
        )


INVARIANT_ROWS = {
    "invariant": "symbol",
    "first": "first",
    "min": "min",
    "max": "max",
    "max deviation": "max_deviation",
    "rms deviation": "rms_deviation",
    "drift per unit time": "drift",
    "± standard error": "drift_error",
    "over the run": "drift_over_run",
    "model": "model",
    "scatter": "scatter",
    "round-off bound": "round_off_bound",
    "verdict": "verdict",
}
RELATIVE = {"max deviation": "max_deviation_relative", "rms deviation": "rms_deviation_relative"}


def test_a_run_shows_the_report_that_it_stored(cli: Callable[..., Any]) -> None:
    command = ("run", "kowalevski_hk", "--set", "N=3000", "--set", "initial.omega=[0.7,-0.4,1.3]")
    rows = [cells_of(line) for line in cli(*command).out.splitlines()]
    (report,) = cli(*command, "--json").json()["runs"]
    assert report["status"] == "up to date"
    invariants = report["invariants"]
    numbers = [value for row in invariants for value in row.values() if isinstance(value, float)]
    assert len(set(numbers)) > 0.8 * len(numbers)  # hardly any two fields are equal
    expect_invariants(rows, invariants)


def expect_invariants(rows: list[list[str]], invariants: list[dict[str, Any]]) -> None:
    """The rows are the report on the invariants, each line once."""
    last, shown = "", []
    for row in rows:
        key = RELATIVE[last] if row[0] == "relative" else INVARIANT_ROWS[row[0]]
        expect(row, row[0], [(one[key],) for one in invariants])
        last = row[0]
        shown.append(key)
    assert shown == list(dict.fromkeys(shown))
    assert set(shown) == {*INVARIANT_ROWS.values(), *RELATIVE.values()}


@pytest.mark.parametrize("swings", [3, 7])
def test_analyse_shows_what_it_measured(cli: Callable[..., Any], monkeypatch: pytest.MonkeyPatch, swings: int) -> None:
    def change(found: Any) -> Any:
        report = distinct(found.data, 5)
        report["swing"]["times"] = [1.25 * i + 0.5 for i in range(swings)]
        return dataclasses.replace(found, data=named_differently(report, ("verdict", "model", "steps_from")))

    monkeypatch.setattr(analyse, "analyse_series", changed_result(change, analyse.analyse_series))
    cli("run", "euler_hk", "--quiet")
    command = ("analyse", "results/euler_hk/series.parquet", "--config", "euler_hk")
    title, *lines = cli(*command).out.splitlines()
    found = cli(*command, "--json").json()
    assert title == f"{found['file']}: {found['top_title']}"
    gap = lines.index("")
    rows = iter([cells_of(line) for line in lines[:gap]])
    swing = found["swing"]
    expect(next(rows), "rows", [(found["rows"],)])
    label, times = next(rows)
    assert label == "times"
    span, _, kind = times.partition(", ")
    assert shows(span, found["t_first"], found["t_last"])
    assert kind == found["times"]
    expect(next(rows), "steps", [(f"{found['steps']} ({found['steps_from']})",)])
    expect(next(rows), "reference from", [("the config's initial state",)])
    expect(next(rows), "first row − config", [(found["reference"]["difference"],)])
    expect(next(rows), "max error", [(found["max_error"],)])
    expect(next(rows), "error at the end", [(found["end_error"],)])
    label, times = next(rows)
    assert label == f"minima of {swing['component']}"
    listed, _, more = times.partition(" and ")
    assert [float(time) for time in listed.split(", ")] == swing["times"][:5]
    assert more == ("2 more" if swings == 7 else "")
    expect(next(rows), "their spacing", [(swing["spacing"], swing["reference_spacing"])])
    assert next(rows, None) is None
    expect_invariants([cells_of(line) for line in lines[gap + 1 :]], found["invariants"])


def test_an_ensemble_shows_the_report_that_it_stored(cli: Callable[..., Any]) -> None:
    command = ("run", "euler_ensemble", "--set", "N=100", "--set", "scheme=hk")
    rows = [cells_of(line) for line in cli(*command).out.splitlines()]
    (report,) = cli(*command, "--json").json()["runs"]
    invariants = report["invariants"]
    titles = {
        "max deviation": "max_deviation",
        "rms deviation": "rms_deviation",
        "deviation at the end": "final_deviation",
    }
    assert rows[0] == ["invariant", *(row["symbol"] for row in invariants)]
    expect(rows[1], "within round-off", [(row["within_round_off"], row["judged"]) for row in invariants])
    for row in rows[2:]:
        title, _, quantile = row[0].rpartition(", ")
        expect(row, row[0], [(one[titles[title]][quantile],) for one in invariants])
    shown = [tuple(row[0].rpartition(", ")[::2]) for row in rows[2:]]
    assert len(shown) == len(set(shown))
    assert {title for title, _ in shown} == set(titles)
    assert {quantile for title, quantile in shown if title == "max deviation"} == set(invariants[0]["max_deviation"])
    assert all({(title, "median"), (title, "max")} <= set(shown) for title in titles)


LISTS = {
    "tops": {"top": "form", "title": "title", "invariants": "invariants"},
    "schemes": {
        "name": "name",
        "top": "top",
        "order": "order",
        "self-adjoint": "self_adjoint",
        "conserves": "conserves",
    },
    "compositions": {
        "name": "name",
        "order": "order",
        "stages": "stages",
        "title": "title",
        "citation": "citation",
    },
    "scenes": {"name": "name", "top": "top", "scheme": "scheme", "h": "h", "N": "N", "about": "about"},
    "sweeps": {"name": "name", "varied": "varied", "about": "about"},
    "cases": {"name": "name", "top": "top", "question": "question"},
    "measures": {"name": "name", "unit": "unit", "summary": "summary"},
    "figures": {"name": "name", "scene": "scene", "title": "title"},
    "runs": {"name": "name", "outcome": "outcome", "scheme": "scheme", "h": "h", "N": "N", "digest": "digest"},
}


@pytest.mark.parametrize("kind", LISTS)
def test_a_list_shows_its_items(cli: Callable[..., Any], kind: str) -> None:
    if kind == "runs":
        for name in ("kowalevski_hk", "euler_hk"):
            cli("run", name, "--set", "N=30", "--quiet")
    first, *lines = cli("list", kind).out.splitlines()
    header, rows = cells_of(first), [cells_of(line) for line in lines]
    if kind == "figures":  # some have no scene
        rows = [cells_under(first, line) for line in lines]
    items = cli("list", kind, "--json").json()[kind]
    assert set(LISTS[kind]) <= set(header)
    for row, item in zip(rows, items, strict=True):
        for name, key in LISTS[kind].items():
            value, cell = item[key], row[header.index(name)]
            match value:
                case bool():
                    assert cell == ("yes" if value else "no")
                case list():
                    assert cell == (", ".join(value) or "–")
                case int() | float():
                    assert float(cell) == pytest.approx(value, rel=1e-5)
                case None:
                    assert cell == "–"
                case _:
                    assert cell == value
        if kind == "tops":
            assert row[header.index("parameters")] == (
                ", ".join(f"{name}={value}" for name, value in item["parameters"].items()) or "–"
            )


def test_stress_shows_its_trials(cli: Callable[..., Any]) -> None:
    command = ("stress", "--top", "euler", "--case", "spherical", "--case", "one-step", "--case", "resonance")
    trials = cli(*command, "--json").json()["trials"]
    assert {one["outcome"] for one in trials} >= {"held", "broke"}
    header, *lines = cli(*command, "--verbose").out.splitlines()
    assert cells_of(header) == ["scheme", "top", "case", "outcome", "why"]
    for line, one in zip(lines, trials, strict=False):
        scheme, top, case, outcome, why, *meaning = cells_of(line)
        assert (scheme, top, case) == (one["scheme"], one["top"], one["case"])
        step = "" if one["step"] is None else f" at step {one['step']}"
        assert outcome == one["outcome"] + step
        assert one["why"].startswith(why.removesuffix(" [...]"))
        assert meaning == {"ok": [], "limit": ["declared limit"]}.get(one["verdict"], [one["verdict"].upper()])


def test_the_grid_of_hard_cases_shows_each_outcome(cli: Callable[..., Any], monkeypatch: pytest.MonkeyPatch) -> None:
    """More trials than are listed one by one: a mark for each scheme and case, in the column of its number."""
    from topcli.studies.stress.study import stress

    asked = ("stress", "hk", "rk4", "dop853", "--top", "kowalevski", "--case", "resonance", "--case", "singular-step")
    judged = stress(["hk", "rk4", "dop853"], ["resonance", "singular-step", "there-and-back"], "kowalevski")
    monkeypatch.setattr("topcli.studies.stress.study.SHOWN", 2)
    monkeypatch.setattr("topcli.studies.stress.study.stress", lambda *arguments: judged)
    said = cli(*asked)
    document = cli(*asked, "--json").json()
    trials = document["trials"]
    header, *rows = said.out.partition("\n\n")[0].splitlines()
    assert header.split() == ["kowalevski", "1", "2", "3"]
    numbers = dict(part.strip().split("=") for part in rows.pop().split(","))
    places = {case: header.rindex(number) for number, case in numbers.items()}
    marks = {"held": "·", "degraded": "o", "broke": "X", "not tried": " "}
    shown = {(row.split()[0], case): row.ljust(len(header))[at] for row in rows for case, at in places.items()}
    assert shown == {(one["scheme"], one["case"]): marks[one["outcome"]] for one in trials}
    assert len(set(shown.values())) >= 3
    counts = {part.split(" ", 1)[1]: int(part.split()[0]) for part in said.err.partition(";")[0].split(", ")}
    assert counts == document["outcomes"]
    assert counts == {name: sum(one["outcome"] == name for one in trials) for name in counts}
    limits = sum(one["verdict"] == "limit" for one in trials)
    assert f"; {limits} of the failures are declared limits" in said.err


def test_doctor_shows_what_it_found(cli: Callable[..., Any], monkeypatch: pytest.MonkeyPatch) -> None:
    from topcli.studies import doctor

    environment = {"python": "3.77.1", "cpu": "Abacus 9", "numba": None}
    cache = {"folder": "/nowhere", "entries": 123, "bytes": 45678, "kept between processes": False}
    plugins = [{"name": "first", "state": "registers one"}, {"name": "second", "state": "failed: no good"}]
    found = {"environment": environment, "cache": cache, "threads": 91, "plugins": plugins, "problems": ["a", "b"]}
    monkeypatch.setattr(doctor, "diagnosis", lambda: {**found, "problems": list(found["problems"])})
    document = cli("doctor", "--json").json()
    assert {key: document[key] for key in found} == found
    rows = [cells_of(line) for line in cli("doctor").out.splitlines()]
    assert rows == [
        *([key, str(value)] for key, value in environment.items()),
        *([f"cache {key}", str(value)] for key, value in cache.items()),
        ["CPU threads", "91"],
        *([f"plugin {one['name']}", one["state"]] for one in plugins),
        ["problems", "a; b"],
    ]


def test_doctor_finds_cache_and_threads_by_itself(cli: Callable[..., Any]) -> None:
    """Against the folder's files and the machine's own count."""
    import os
    from pathlib import Path

    found = cli("doctor", "--json").json()
    before = {path: path.stat().st_size for path in Path(found["cache"]["folder"]).rglob("*") if path.is_file()}
    assert found["threads"] == len(os.sched_getaffinity(0))
    assert 0 < found["cache"]["entries"] <= len(before)
    assert 0 < found["cache"]["bytes"] <= sum(before.values())


FIELDS = {
    "schemes": ("name", "top", "title", "order", "explicit", "self_adjoint", "equations", "citation", "origin"),
    "tops": ("form", "title", "citation"),
    "compositions": ("name", "order", "stages", "title", "citation"),
    "cases": ("name", "question"),
    "figures": ("name", "title"),
}


@pytest.mark.parametrize("kind", FIELDS)
def test_a_list_in_json_has_the_fields_of_what_is_registered(cli: Callable[..., Any], kind: str) -> None:
    from topcli.figures.catalogue import FIGURES
    from topcli.schemes.compose import COMPOSITIONS
    from topcli.schemes.registry import all_schemes
    from topcli.studies.stress.cases import CASES
    from topcli.tops import TOPS

    registered: dict[str, list[Any]] = {
        "schemes": list(all_schemes()),
        "tops": list(TOPS.values()),
        "compositions": list(COMPOSITIONS.values()),
        "cases": list(CASES),
        "figures": list(FIGURES.values()),
    }
    items = cli("list", kind, "--json").json()[kind]
    for item, one in zip(items, registered[kind], strict=True):
        assert {key: item[key] for key in FIELDS[kind]} == {key: getattr(one, key) for key in FIELDS[kind]}
        if kind == "schemes":
            assert item["conserves"] == list(one.conserves)
            assert item["limits"] == dict(one.limits)
            assert set(item["options"]) == set(one.options.model_fields)
        if kind == "tops":
            assert (item["name"], item["components"]) == (one.kind, list(one.components))
