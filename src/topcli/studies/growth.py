"""Growth of round-off for several ways to write a step: the data of the figure ``roundoff``.

The BS scheme of Lagrange's top turns the axis by Cayley's rotation. Written as a product of matrix and vector, it is
biased; as axis + change, its errors are a random walk; with compensated sums, a smaller one. The hybrid recomputes xi
from the state in every step; hybrid-xi carries it as a unit number that turns, and its errors do not add up.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from topcli.analysis.roundoff import doubling_lags, structure
from topcli.arithmetic.rotations import cayley_increment, cayley_matrix_product
from topcli.config.load import load_experiment
from topcli.config.models import Experiment
from topcli.contracts import Array, Floats, Stepper
from topcli.engine.fingerprint import fingerprint
from topcli.runs.identity import method_fingerprint
from topcli.schemes.layout import stepper
from topcli.studies.roundoff import copies_followed, sampling_of

STEPS = 1 << 19
COPIES = 4
H = 0.01


def turned_step(s: Floats, h: float, p: Floats) -> Floats:
    """BS step with the axis turned by the matrix of Cayley's rotation: the biased form."""
    m1, m2, m3, a1, a2, a3 = s
    d = -0.5 * h
    n1, n2 = m1 - h * a2, m2 + h * a1
    b1, b2, b3 = cayley_matrix_product(d * n1, d * n2, d * m3, a1, a2, a3)
    return (n1, n2, m3, b1, b2, b3)


def bs_change(s: Floats, h: float, p: Floats) -> Floats:
    """Change in a BS step."""
    m1, m2, m3, a1, a2, a3 = s
    d = -0.5 * h
    x1, x2 = -(h * a2), h * a1
    y1, y2, y3 = cayley_increment(d * (m1 + x1), d * (m2 + x2), d * m3, a1, a2, a3)
    return (x1, x2, 0.0, y1, y2, y3)


def _under(experiment: Experiment, method: Stepper) -> Experiment:
    """Experiment under a step that is not registered as a scheme."""
    return experiment.model_copy(update={"scheme": replace(experiment.scheme, build=lambda top, options: method)})


def _variants() -> dict[str, tuple[Experiment, str]]:
    """Experiment and invariant of each curve, by the name of its column."""
    lagrange = load_experiment("lagrange_bs", [f"h={H}"])
    compensated = stepper(bs_change, 6, lost=range(6), checked=6)
    found = {
        "a_sq:matrix": (_under(lagrange, Stepper(turned_step, 6)), "a_sq"),
        "a_sq:plain": (lagrange, "a_sq"),
        "a_sq:compensated": (_under(lagrange, compensated), "a_sq"),
    }
    for name in ("hybrid", "hybrid-xi"):
        found[f"k_sq:{name}"] = (load_experiment("kowalevski_generic_hk", [f"h={H}", f"scheme={name}"]), "k_sq")
    return found


def growth_columns() -> Mapping[str, Array]:
    """Columns of the figure: ``steps``, and for each curve the root mean square of the drift over that many steps."""
    sampling = sampling_of(STEPS, H, exact=True)
    lags = doubling_lags(sampling.blocks)
    columns: dict[str, Array] = {"steps": lags * float(sampling.block_steps)}
    for name, (experiment, invariant) in _variants().items():
        watched = [one for one in experiment.top.invariants() if one.name == invariant]
        columns[name] = structure(copies_followed(experiment, watched, sampling, COPIES).means[0], lags)
    return columns


def growth_code() -> str:
    """Digest of everything that the columns depend on; equal digests mean equal columns."""
    digests = [method_fingerprint(experiment.method()) + experiment.digest for experiment, _ in _variants().values()]
    code = fingerprint(sampling_of, copies_followed, doubling_lags, structure, compiled=False)
    return code + "".join(digests) + f"{STEPS} {COPIES}"
