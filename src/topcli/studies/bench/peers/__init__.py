"""Integrators of other projects to compare with: one small file per peer, registered in ``PEERS``.

A peer is imported only in a process of its own (``worker``), so that whatever it loads, prints or breaks stays there.
Peers that are not installed are skipped with a message.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from importlib.util import find_spec

from topcli.errors import UnknownNameError, UsageError, nearest, quoted


class NoResultError(Exception):
    """One setting of a competitor gave no trajectory; the message is the reason."""


@dataclass(frozen=True)
class Peer:
    """One peer: its ``name`` on the command line, the ``module`` with its settings, the packages it ``requires``.

    ``varies`` is True if its speed differs between processes; the best of several then counts. ``patience`` multiplies
    the usual time allowed for a call, for a peer that runs in the interpreter. The extra of the same name installs the
    required packages.
    """

    name: str
    title: str
    module: str
    requires: tuple[str, ...]
    varies: bool = False
    patience: float = 1.0


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
    )
}


def find_peers(names: Sequence[str]) -> list[Peer]:
    """Return the peers called ``names``, matched without case. Raises UnknownNameError or UsageError."""
    keys = [name.lower() for name in names]
    for i, key in enumerate(keys):
        if key not in PEERS:
            raise UnknownNameError(f"--against: unknown peer {quoted(names[i])}; {nearest(names[i], PEERS)}")
        if key in keys[:i]:
            raise UsageError(f"--against: peer {quoted(names[i])} is named twice")
    return [PEERS[key] for key in keys]


def missing(peer: Peer) -> str:
    """Reason why ``peer`` cannot be measured here; empty if its packages are installed."""
    absent = [package for package in peer.requires if find_spec(package) is None]
    return f"{' and '.join(absent)} not installed; run pip install 'topcli[{peer.name}]'" if absent else ""
