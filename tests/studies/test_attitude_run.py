"""The attitude in configs, run folders and the Python interface, and where it is refused."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import topcli
from config_texts import BASE, refusal, write
from conftest import Said
from resuming import HK, after, content, small
from topcli.config.load import load, load_experiment
from topcli.config.rows import RowReader
from topcli.config.sweep import load_sweep
from topcli.contracts import Outcome
from topcli.errors import UsageError
from topcli.runs.decision import RunOptions
from topcli.runs.identity import Identity
from topcli.runs.run import run_experiment
from topcli.schemes.registry import scheme
from topcli.store.series import read_series
from topcli.studies.entries import read_entries

QUATERNION, ANGLES = "output.attitude=quaternion", "output.attitude=euler-angles"


@pytest.mark.parametrize("suffix", ["parquet", "csv"])
def test_series_holds_the_attitude_behind_the_other_columns(tmp_path: Path, suffix: str) -> None:
    one = small(QUATERNION, f"output.format={suffix}").renamed("one")
    run = run_experiment(one, tmp_path)
    series = read_series(run.stored.series)
    plain = read_series(run_experiment(small(f"output.format={suffix}"), tmp_path).stored.series)
    assert list(series) == [*plain, "q0", "q1", "q2", "q3"]
    assert all(series[name].tobytes() == plain[name].tobytes() for name in plain)
    q = np.column_stack([series[f"q{i}"] for i in range(4)])
    gamma = np.column_stack([series[f"gamma{i}"] for i in (1, 2, 3)])
    up = Rotation.from_quat(q, scalar_first=True).apply(gamma / np.linalg.norm(gamma, axis=1, keepdims=True))
    assert np.abs(up - [0.0, 0.0, 1.0]).max() < 1e-15
    assert q[:, 0].min() >= 0.0


def test_euler_angles_are_those_of_the_quaternion() -> None:
    one = topcli.simulate(HK, N=200, output={"attitude": "quaternion"})
    other = topcli.simulate(HK, N=200, output={"attitude": "euler-angles"})
    assert list(one.to_pandas())[-4:] == ["q0", "q1", "q2", "q3"]
    assert list(other.to_pandas())[-3:] == ["psi", "theta", "phi"]
    assert one.attitude is not None
    assert other.attitude is not None
    assert one.attitude.shape == (201, 4)
    assert one.states.shape == (201, 6)
    assert one.attitude.tobytes() == other.attitude.tobytes()
    angles = np.column_stack([one[name] for name in ("psi", "theta", "phi")])
    expected = Rotation.from_quat(one.attitude, scalar_first=True)
    assert (Rotation.from_euler("ZXZ", angles) * expected.inv()).magnitude().max() < 1e-14
    assert np.abs(np.cos(one["theta"]) - one["gamma3"]).max() < 1e-14
    with pytest.raises(UsageError, match="no column 'q0'"):
        topcli.simulate(HK, N=10)["q0"]


def test_another_format_is_rewritten_with_the_same_attitude(tmp_path: Path) -> None:
    first = read_series(run_experiment(small(ANGLES), tmp_path).stored.series)
    again = run_experiment(small(ANGLES, "output.format=csv"), tmp_path)
    assert again.status == "rewritten as csv"
    second = read_series(again.stored.series)
    assert list(second) == list(first)
    assert all(second[name].tobytes() == first[name].tobytes() for name in first)


def test_columns_may_place_the_attitude() -> None:
    assert small(ANGLES, "output.columns=[t, theta]").recorded == ["t", "theta", "psi", "phi"]
    assert small(QUATERNION, "output.columns=[t]").recorded == ["t", "q0", "q1", "q2", "q3"]
    assert small("output.columns=[t]").recorded == ["t"]


def test_the_attitude_enters_the_identity_only_if_recorded() -> None:
    plain, turned, angles = small(), small(QUATERNION), small(ANGLES)
    assert "attitude" not in plain.resolved()["output"]
    assert small("output.attitude=null").digest == plain.digest
    assert len({plain.digest, turned.digest, angles.digest}) == 3
    assert load_experiment(turned.resolved()).digest == turned.digest
    codes = {Identity.of(one, [one.method()]).code for one in (plain, turned)}
    assert len(codes) == 2


def test_a_change_of_the_turns_is_a_change_of_the_code(monkeypatch: pytest.MonkeyPatch) -> None:
    from topcli.engine import attitude

    plain, turned = small(), small(QUATERNION)
    before = [Identity.of(one, [one.method()]).code for one in (plain, turned)]
    monkeypatch.setattr(attitude, "RESOLVED", 2.0**-40)
    now = [Identity.of(one, [one.method()]).code for one in (plain, turned)]
    assert now[0] == before[0]
    assert now[1] != before[1]


@pytest.mark.parametrize("suffix", ["parquet", "csv"])
@pytest.mark.parametrize("name", ["hk", "taylor"])
def test_an_interrupted_run_resumes_bit_for_bit(tmp_path: Path, small_chunks: None, suffix: str, name: str) -> None:
    one = small(QUATERNION, f"scheme={name}", "output.every=3", f"output.format={suffix}")
    whole = run_experiment(one, tmp_path / "whole")
    first = run_experiment(one, tmp_path / "parts", RunOptions(stop=after(2)))
    assert first.outcome is Outcome.INTERRUPTED
    assert first.report["step"] < 300
    second = run_experiment(one, tmp_path / "parts", RunOptions(resume=True))
    assert second.status == "resumed"
    assert content(second.stored.folder) == content(whole.stored.folder)


def test_a_run_without_attitude_is_not_resumed_with_it(tmp_path: Path, small_chunks: None) -> None:
    run_experiment(small(), tmp_path, RunOptions(stop=after(2)))
    with pytest.raises(UsageError, match=r"output\.attitude: nothing there, quaternion here"):
        run_experiment(small(QUATERNION), tmp_path, RunOptions(resume=True))


def test_values_of_another_kind_are_refused(tmp_path: Path) -> None:
    path = write(tmp_path, BASE)
    assert "must be 'quaternion' or 'euler-angles', not the text 'matrix'" in refusal(path, ("output.attitude=matrix",))
    needs = refusal(path, ("output.columns=[t, q0]",))
    assert "output.columns: 'q0' needs output.attitude: quaternion" in needs
    other = refusal(path, (QUATERNION, "output.columns=[t, psi]"))
    assert "output.columns: 'psi' needs output.attitude: euler-angles" in other


def test_other_kinds_of_runs_refuse_it_by_name(tmp_path: Path) -> None:
    for precision in ("50", "rational"):
        with pytest.raises(UsageError, match=r"output\.attitude: the attitude is computed in doubles only"):
            load_experiment(HK, [QUATERNION, f"precision={precision}"], any_precision=True)
    with pytest.raises(UsageError, match=r"output\.attitude: an ensemble records no attitude"):
        load("kowalevski_ensemble", [QUATERNION])
    with pytest.raises(UsageError, match=r"output\.attitude: a comparison records no attitude; add --set"):
        read_entries(small(QUATERNION), ["hk", "taylor"])
    base = small(QUATERNION).resolved()
    del base["name"]
    sweep = load_sweep({"name": "s", "base": base, "grid": {"h": [0.1, 0.2]}})
    with pytest.raises(UsageError, match=r"output\.attitude: a sweep records no attitude"):
        list(RowReader(sweep).rows())


def test_a_top_that_the_equations_do_not_describe_is_refused(own_registry: None) -> None:
    from topcli.tops import TOPS
    from topcli.tops.heavy import Heavy

    class Gyrostat(Heavy):
        """A heavy top with a flywheel."""

        kind = form = "gyrostat"

        def euler_poisson(self) -> object:
            raise NotImplementedError

    TOPS["gyrostat"] = Gyrostat
    config = {"top": "gyrostat", "initial": {"omega": [1, 0, 0], "gamma": [0, 0, 1]}, "h": 0.1, "N": 5}
    plain = {"title": "x", "order": 1, "explicit": True, "self_adjoint": False, "citation": "x", "equations": "x"}

    @scheme("still", top="gyrostat", **plain)
    def still(top: object, options: object) -> topcli.Stepper:
        """Stands still."""
        return topcli.Stepper(lambda s, h, p: s, 6)

    with pytest.raises(UsageError, match=r"output\.attitude: top 'gyrostat': the attitude needs"):
        load_experiment({**config, "scheme": "still", "output": {"attitude": "quaternion"}})


def test_the_command_records_it(in_tmp: Path, cli: Callable[..., Said]) -> None:
    said = cli("run", "lagrange_cusps", "--set", ANGLES, "--set", "T=1", "--format", "csv", "--name", "angles")
    assert said.code == 0
    header = (in_tmp / "results" / "angles" / "series.csv").read_text().splitlines()[0]
    assert header.endswith(",psi,theta,phi")
