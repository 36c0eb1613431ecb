"""Time of a single step of each scheme, against HK by straightforward block elimination.

    python benchmarks/steps.py [--repetitions 21] [--tangents] [SCHEME[/TOP]...]

All steps run in topcli's time loop. A scheme and the baseline are timed in turn; the ratio is the median over the
repetitions, with quartiles; times are processor times, which other work on the machine stretches less. With
--tangents, a column has the time of a step with a tangent vector over that of the step. Compositions are named as in
`hk+yoshida4`. Compare the results of two versions of topcli on an idle machine only.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Callable, Sequence

import numpy as np

from topcli.contracts import Method, Sampler, Scheme, Stepper, Top
from topcli.engine.loops import loop_of
from topcli.engine.tangent import TangentRun, tangent_code
from topcli.errors import UsageError
from topcli.schemes.registry import all_schemes, find_scheme
from topcli.tops import CATALOGUE, TOPS
from topcli.tops.kowalevski import Kowalevski

GENERIC = np.array([0.7, -0.4, 1.3, 0.6, 0.48, 0.64])
H, STEPS = 0.01, 64_000


def hk_block(state, h, p):
    """HK step of the Kowalevski top: gamma' = P + Q omega' by Cayley's inverse, then Cramer's rule for omega'."""
    w1, w2, w3, g1, g2, g3 = state
    c = p[0]
    d = 0.5 * h
    a1, a2, a3 = d * w1, d * w2, d * w3
    n = 1.0 / (1.0 + a1 * a1 + a2 * a2 + a3 * a3)
    i11, i12, i13 = (1.0 + a1 * a1) * n, (a1 * a2 + a3) * n, (a1 * a3 - a2) * n
    i21, i22, i23 = (a1 * a2 - a3) * n, (1.0 + a2 * a2) * n, (a2 * a3 + a1) * n
    i31, i32, i33 = (a1 * a3 + a2) * n, (a2 * a3 - a1) * n, (1.0 + a3 * a3) * n
    p1 = i11 * g1 + i12 * g2 + i13 * g3
    p2 = i21 * g1 + i22 * g2 + i23 * g3
    p3 = i31 * g1 + i32 * g2 + i33 * g3
    q11, q12, q13 = d * (i12 * g3 - i13 * g2), d * (i13 * g1 - i11 * g3), d * (i11 * g2 - i12 * g1)
    q21, q22, q23 = d * (i22 * g3 - i23 * g2), d * (i23 * g1 - i21 * g3), d * (i21 * g2 - i22 * g1)
    q31, q32, q33 = d * (i32 * g3 - i33 * g2), d * (i33 * g1 - i31 * g3), d * (i31 * g2 - i32 * g1)
    f = d * c
    k = 0.5 * f
    e = 0.5 * d
    m12, m13 = -e * w3, -e * w2
    m21, m22, m23 = e * w3 - k * q31, 1.0 - k * q32, e * w1 - k * q33
    m31, m32, m33 = f * q21, f * q22, 1.0 + f * q23
    r1, r2, r3 = w1, w2 + k * (g3 + p3), w3 - f * (g2 + p2)
    c1 = m22 * m33 - m23 * m32
    c2 = m23 * m31 - m21 * m33
    c3 = m21 * m32 - m22 * m31
    det = c1 + m12 * c2 + m13 * c3
    x1 = (r1 * c1 + m12 * (m23 * r3 - r2 * m33) + m13 * (r2 * m32 - m22 * r3)) / det
    x2 = ((r2 * m33 - m23 * r3) + r1 * c2 + m13 * (m21 * r3 - r2 * m31)) / det
    x3 = ((m22 * r3 - r2 * m32) + m12 * (r2 * m31 - m21 * r3) + r1 * c3) / det
    return (
        x1,
        x2,
        x3,
        p1 + q11 * x1 + q12 * x2 + q13 * x3,
        p2 + q21 * x1 + q22 * x2 + q23 * x3,
        p3 + q31 * x1 + q32 * x2 + q33 * x3,
    )


def stepping(top: Top, method: Method) -> Callable[[], float]:
    """Function that measures the nanoseconds per step of one trajectory."""
    p, d = np.array(top.constants()), len(top.components)
    loop, out = loop_of(method, d, len(p)), np.empty(d)
    start = np.zeros(loop.width)
    loop.enter(np.resize(GENERIC, d), start, p, H)

    def measured() -> float:
        work = start.copy()
        begin = time.thread_time_ns()
        if loop.take_steps(work, out, p, H, STEPS, STEPS + 1, STEPS + 1) != STEPS:
            raise RuntimeError(f"{top.form}: a step failed")
        return (time.thread_time_ns() - begin) / STEPS

    return measured


def with_tangent(top: Top, scheme: Scheme, method: Method) -> Callable[[], float]:
    """Function that measures the nanoseconds per step with a tangent vector."""
    d = len(top.components)
    run = TangentRun(tangent_code(scheme, top, method, 1), H, np.resize(GENERIC, (1, d)), np.ones((1, d)))

    def measured() -> float:
        begin = time.thread_time_ns()
        run.advance(STEPS)
        return (time.thread_time_ns() - begin) / STEPS

    return measured


def straightforward() -> Callable[[], float]:
    """Function that measures the baseline."""
    return stepping(Kowalevski(), Stepper(hk_block, 6))


def ratio(times: Sequence[float], others: Sequence[float]) -> str:
    """Median of the ratios, with quartiles."""
    low, middle, high = statistics.quantiles([a / b for a, b in zip(times, others, strict=True)], n=4)
    return f"{middle:.3f} ({low:.3f} to {high:.3f})"


def show(name: str, baseline: Callable[[], float], repetitions: int, tangents: bool) -> None:
    """Time one scheme and print its row."""
    scheme_name, _, form = name.partition("/")
    scheme, top = find_scheme(scheme_name, form or "kowalevski"), TOPS[form or "kowalevski"].new()
    method = scheme.build(top, scheme.options())
    if isinstance(method, Sampler):  # a closed form takes no steps
        return
    timed = [baseline, stepping(top, method)]
    if tangents:
        try:
            timed.append(with_tangent(top, scheme, method))
        except UsageError:
            tangents = False
    rows = [[measured() for measured in timed] for _ in range(repetitions + 1)][1:]  # the first repetition warms up
    base, own, *derived = zip(*rows, strict=True)
    last = ratio(derived[0], own) if tangents else ""
    print(f"{name:<32}{statistics.median(own):>10.1f}   {ratio(own, base):<28}{last}", flush=True)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="SCHEME[/TOP]", help="default: every scheme of the paper's tops")
    parser.add_argument("--repetitions", type=int, default=21)
    parser.add_argument("--tangents", action="store_true")
    arguments = parser.parse_args()
    names = arguments.names or [
        f"{scheme.name}/{scheme.top}" for scheme in all_schemes() if not scheme.adaptive and scheme.top not in CATALOGUE
    ]
    print(f"{'':<32}{'ns/step':>10}   {'to straightforward HK':<28}{'with tangent' * arguments.tangents}")
    baseline = straightforward()
    for name in names:
        show(name, baseline, arguments.repetitions, arguments.tangents)


if __name__ == "__main__":
    main()
