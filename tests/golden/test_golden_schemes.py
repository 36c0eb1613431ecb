"""Every scheme with every choice of its options, in plain Python: states after a few steps, and what is declared."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import golden
from conformance import choices
from conftest import PAPER, random_states
from declared import TRIALS, gen
from topcli.contracts import Scheme, Stepper, Top
from topcli.engine.drive import orbit
from topcli.engine.loops import interpreted
from topcli.schemes.registry import all_schemes
from topcli.tops import TOPS
from topcli.tops.bodies import moment_warnings

STEPS = 12


def state_after(top: Top, scheme: Scheme, options: Any, y0: Any, h: float) -> dict[str, Any]:
    """State after some steps: of plain Python, or of a closed form or a series."""
    method, y0 = scheme.build(top, options), np.asarray(y0, dtype=float)
    if not isinstance(method, Stepper):
        return {"state": orbit(top, method, y0, h, STEPS, STEPS).states[-1].tolist()}
    p = np.array(method.parameters(top))
    loop = interpreted(method, len(y0), len(p))
    work, out = np.zeros(method.width), np.zeros(STEPS * len(y0))
    loop.enter(y0, work, p, h)
    taken = loop.take_steps(work, out, p, h, STEPS, 1, 1)
    counts = dict(zip(method.counters, work[len(work) - len(method.counters) :].tolist(), strict=True))
    return {"taken": int(taken), "state": out.reshape(STEPS, -1)[max(taken, 1) - 1].tolist(), "counts": counts}


def declaration(scheme: Scheme, top: Top) -> dict[str, Any]:
    """Declared properties of a scheme, with the values of its modified integrals."""
    modified = scheme.modified(top, 0.1, scheme.options()) if scheme.modified else ()
    y = np.array([gen(top)])
    return {
        **{key: getattr(scheme, key) for key in ("order", "explicit", "self_adjoint", "conserves", "adaptive")},
        "limits": sorted(scheme.limits),
        "modified": {invariant.name: float(invariant.value(y)[0]) for invariant in modified},
    }


def starts_of(top: Top) -> list[Any]:
    """Initial states of a top to try its schemes from."""
    d = len(top.components)
    if d > 6:
        return [gen(top), (0.3,) * d]
    return [gen(top), *random_states(2, seed=5)[:, :d], *([PAPER] if top.form == "kowalevski" else [])]


@pytest.mark.slow
@pytest.mark.parametrize("form", list(TOPS))
def test_schemes(form: str) -> None:
    rows: dict[str, Any] = {}
    for scheme in (scheme for scheme in all_schemes() if scheme.top == form):
        row = rows[scheme.name] = declaration(scheme, TRIALS[form][0])
        for i, top in enumerate(TRIALS[form][:2]):
            for options in choices(scheme, top) if i == 0 else [scheme.options()]:
                for j, y0 in enumerate(starts_of(top)):
                    for h in (0.05, -0.2):
                        key = f"{i} {j} {h} {options.model_dump(exclude_defaults=True)}"
                        try:
                            row[key] = state_after(top, scheme, options, y0, h)
                        except Exception as error:
                            row[key] = f"{type(error).__name__}: {error}"[:200]
    golden.check(f"schemes_{form.replace('/', '-')}", rows, rel=1e-12)  # bits of C libraries differ


@pytest.mark.parametrize("form", list(TOPS))
def test_tops(form: str) -> None:
    rows = []
    for top in TRIALS[form]:
        d = len(top.components)
        y = random_states(5, seed=9)[:, :d] if d <= 6 else np.full((5, d), 0.4)
        invariants = {
            invariant.name: [invariant.value(y).tolist(), invariant.scale(y).tolist(), invariant.symbol]
            for invariant in top.invariants()
        }
        field = [list(type(top).field(tuple(state), top.constants())) for state in y.tolist()]
        constants, warnings = top.constants(), moment_warnings(top)
        rows.append({"constants": constants, "invariants": invariants, "field": field, "warnings": warnings})
    golden.check(f"tops_{form.replace('/', '-')}", rows, rel=1e-12)
