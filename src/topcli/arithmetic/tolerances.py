"""Constants of iterations that depend on the precision of the arithmetic.

A module declares beside its constants which of them follow the rounding error, and which are maximum numbers of
iterations. In double precision the declaration has no effect; a copy of a function for another arithmetic
(``engine.precise``) uses the constants scaled to it.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence

_POWERS: dict[tuple[str, str], float] = {}
_CAPS: set[tuple[str, str]] = set()


def follow_precision(module: str, *, caps: Sequence[str] = (), **powers: float) -> None:
    """Declare constants of ``module`` that follow the precision.

    Parameters
    ----------
    module : str
        ``__name__`` of the module.
    caps : sequence of str
        Names of maximum numbers of iterations, which grow in proportion to the number of digits.
    **powers
        Names of tolerances, each with the power of the rounding error to which it is proportional: 1 for a multiple of
        the rounding error, 0.5 for its square root. A guard against division by 0 has a large power.
    """
    _CAPS.update((module, name) for name in caps)
    _POWERS.update({(module, name): power for name, power in powers.items()})


def is_cap(module: str, name: str, value: object) -> bool:
    """True if the global ``name`` of ``module``, its own or an imported one, is a declared number of iterations."""
    return _declared(_CAPS, module, name, value) is not None


def power_of(module: str, name: str, value: object) -> float | None:
    """Power of the rounding error that the global ``name`` of ``module`` follows; None for any other constant."""
    found = _declared(_POWERS, module, name, value)
    return None if found is None else _POWERS[found]


def _declared(
    known: dict[tuple[str, str], float] | set[tuple[str, str]], module: str, name: str, value: object
) -> tuple[str, str] | None:
    if (module, name) in known:
        return (module, name)
    # an imported constant has the name that it was declared by, and is the same object
    same = (key for key in known if key[1] == name and getattr(sys.modules.get(key[0]), name, None) is value)
    return next(same, None)
