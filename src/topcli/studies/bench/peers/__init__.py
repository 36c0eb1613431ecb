"""Integrators of other projects to compare with: one small file per peer, registered in ``PEERS``.

A peer is imported only in a process of its own (``worker``), so that whatever it loads, prints or breaks stays there.
Peers that are not installed are skipped with a message.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from importlib.util import find_spec

from topcli.errors import UnknownNameError, UsageError, nearest, quoted


@dataclass(frozen=True)
class Peer:
    """One peer: its ``name`` on the command line, the ``module`` with its settings, the packages it ``requires``.

    ``varies`` is True if its speed differs between processes; the best of several then counts. ``patience`` multiplies
    the usual time allowed for a call, for a peer that runs in the interpreter. The extra of the same name installs the
    required packages; ``needs`` names the prerequisites of that installation.
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
            "topcli.studies.bench.peers.scipy_dop853",
            ("scipy", "numba"),
            patience=50.0,
        ),
        Peer(
            "heyoka", "heyoka's adaptive Taylor series", "topcli.studies.bench.peers.heyoka_taylor", ("heyoka",), True
        ),
        Peer(
            "diffrax",
            "diffrax's Dopri8 and Tsit5 under jax.jit",
            "topcli.studies.bench.peers.diffrax_rk",
            ("diffrax", "jax"),
            patience=5.0,
        ),
        Peer(
            "numbalsoda",
            "numbalsoda's dop853 and lsoda, right-hand side compiled by numba",
            "topcli.studies.bench.peers.numbalsoda_ode",
            ("numbalsoda", "numba"),
            patience=5.0,
            needs="needs CMake and a Fortran compiler",
        ),
    )
}


def find_peers(names: Sequence[str]) -> list[Peer]:
    """Return the peers called ``names``, matched without case. Raises UnknownNameError or UsageError."""
    found = []
    for name in names:
        if name.lower() not in PEERS:
            raise UnknownNameError(f"--against: unknown peer {quoted(name)}; {nearest(name, PEERS)}")
        if PEERS[name.lower()] in found:
            raise UsageError(f"--against: peer {quoted(name)} is named twice")
        found.append(PEERS[name.lower()])
    return found


def missing(peer: Peer) -> str:
    """Reason why ``peer`` cannot be measured here; empty if its packages are installed."""
    absent = [package for package in peer.requires if find_spec(package) is None]
    if not absent:
        return ""
    needs = f" ({peer.needs})" if peer.needs else ""
    return f"{' and '.join(absent)} not installed; run pip install 'topcli[{peer.name}]'{needs}"
