"""The energy over a long time: the data behind the figure of integrable maps."""

from __future__ import annotations

import numpy as np
import pytest

import topcli
from topcli.figures import long_energy


def test_octaves_are_cut_at_powers_of_two() -> None:
    values = np.array([1.0, 5.0, 2.0, 0.0, 3.0, 9.0, 4.0])
    numbers = np.arange(1.0, 8.0)
    assert long_energy.largest_by_octave(numbers, values).tolist() == [1.0, 5.0, 9.0]
    assert long_energy.largest_by_octave(numbers[:4], values[:4]).tolist() == [1.0, 5.0, 0.0]


def test_columns_are_the_deviations_of_the_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    """By the formula of the energy, for one scheme of each scene; the control drifts."""
    monkeypatch.setattr(long_energy, "STEPS", 1 << 10)
    columns = long_energy.energy_columns()
    y = topcli.simulate("kowalevski_generic_hk", scheme="splitting", h=0.05, N=1023).states
    energy = y[:, 0] ** 2 + y[:, 1] ** 2 + 0.5 * y[:, 2] ** 2 + y[:, 3]
    errors = np.abs(energy - energy[0])[512:1024] / (0.49 + 0.16 + 0.5 * 1.69 + 0.6)
    assert columns["kowalevski_generic_hk:splitting"][-1] == pytest.approx(errors.max(), rel=1e-9)
    assert columns["t:euler_hk"].tolist() == [0.05 * 2.0**k for k in range(1, 11)]
    assert len(columns["euler_hk:dmv"]) == 10
    assert np.nanmax(columns["euler_hk:dmv"]) < 1e-13
    assert columns["euler_hk:splitting"].max() > 1e-5
    assert columns["euler_hk:rk4"][-1] > 2.0 * columns["euler_hk:rk4"][-3]


def test_code_of_the_figure_names_what_it_depends_on(monkeypatch: pytest.MonkeyPatch) -> None:
    before = long_energy.energy_code()
    assert long_energy.energy_code() == before
    monkeypatch.setitem(long_energy.SIZES, "euler_hk", 0.06)
    assert long_energy.energy_code() != before
