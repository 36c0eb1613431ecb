"""Other people's integrators, to measure ours against: one small file a peer, registered in ``PEERS``.

A peer is imported only in a process of its own (``worker``), so that what it loads, prints or breaks stays there.
One that is not installed is left out by name.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from importlib.util import find_spec

from topcli.errors import UnknownNameError, UsageError, nearest, quoted


@dataclass(frozen=True)
class Peer:
    """One peer: its ``name`` on the command line, the ``module`` with its settings, the packages it ``requires``.

    ``varies`` says that its speed differs from process to process, so that it counts as its best of several.
    ``patience`` is how many times the usual seconds a call may take; what runs in the interpreter needs more.
    The extra of the same name installs what it requires; ``needs`` says what must be there before.
    """

    name: str
    title: str
    module: str
    requires: tuple[str, ...]
    varies: bool = False
    patience: float = 1.0
    needs: str = ""


PEERS: dict[str, Peer] = {
    peer.name: peer
    for peer in (
        Peer(
            "scipy",
            "SciPy's DOP853, right-hand side in Python and compiled by numba",
            "topcli.studies.peers.scipy_dop853",
            ("scipy", "numba"),
            patience=50.0,
        ),
        Peer("heyoka", "heyoka's adaptive Taylor series", "topcli.studies.peers.heyoka_taylor", ("heyoka",), True),
        Peer(
            "diffrax",
            "diffrax's Dopri8 and Tsit5 under jax.jit",
            "topcli.studies.peers.diffrax_rk",
            ("diffrax", "jax"),
            patience=5.0,
        ),
        Peer(
            "numbalsoda",
            "numbalsoda's dop853 and lsoda, right-hand side compiled by numba",
            "topcli.studies.peers.numbalsoda_ode",
            ("numbalsoda", "numba"),
            patience=5.0,
            needs="needs CMake and a Fortran compiler",
        ),
    )
}


def find_peers(names: Sequence[str]) -> list[Peer]:
    """The peers called ``names``, matched without case. Raises UnknownNameError with the nearest, or UsageError."""
    found = []
    for name in names:
        if name.lower() not in PEERS:
            raise UnknownNameError(f"--against: unknown peer {quoted(name)}; {nearest(name, PEERS)}")
        if PEERS[name.lower()] in found:
            raise UsageError(f"--against: peer {quoted(name)} is named twice")
        found.append(PEERS[name.lower()])
    return found


def missing(peer: Peer) -> str:
    """Why ``peer`` cannot be measured here; empty when all that it requires is installed."""
    absent = [package for package in peer.requires if find_spec(package) is None]
    if not absent:
        return ""
    needs = f" ({peer.needs})" if peer.needs else ""
    return f"{' and '.join(absent)} not installed; run pip install 'topcli[{peer.name}]'{needs}"
