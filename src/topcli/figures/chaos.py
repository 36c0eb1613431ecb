"""Order and chaos: finite-time Lyapunov exponents of an orbit."""

from __future__ import annotations

import numpy as np

from topcli.figures.figure import Loaded
from topcli.figures.picture import Grid, Line, Panel
from topcli.studies.study import Result

REGULAR = "regular"


def loaded_lyapunov(result: Result) -> Loaded:
    """The figure of ``topcli lyapunov``; nothing is drawn of an orbit that broke off."""
    study, columns = result.data, dict(result.arrays)
    if study["verdict"] == "broke off" or "t" not in columns:
        return Loaded((), dict, study["config"], Grid())
    t, names = columns["t"], [name for name in columns if name.startswith("exponent")]
    # the growth of a regular orbit of this unit of time, which the study gives at the end
    unit = np.expm1(study["regular_exponent"] * t[-1]) / t[-1]
    columns[REGULAR] = np.log1p(unit * t) / t
    alone = len(names) == 1
    lines = [Line(name, "exponent" if alone else rf"$\lambda_{i + 1}$") for i, name in enumerate(names)]
    lines.append(Line(REGULAR, "regular orbit: $\\ln(t)/t$"))
    config = study["config"]
    panel = Panel(
        tuple(lines),
        ylabel="exponent per unit of time",
        xlog=True,
        log=alone and bool((columns[names[0]] > 0.0).all()),
        title=f"{config['scheme']['name']}, $h = {config['h']:g}$: {study['verdict']}",
    )
    return Loaded((panel,), lambda: columns, config, Grid(figsize=(5.4, 3.2)))
