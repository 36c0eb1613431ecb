"""Identity of a run: the digest of its computation, and the digest of the code that carries it out.

What a run computes and records is its resolved config without the name and the format of the series: top and
parameters, initial state or ensemble, scheme and options, h, N, recorded rows and columns. A name says where a run is
stored, and every format holds the same bits.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from pydantic import ValidationError

from topcli.config.models import Experiment, digest_of
from topcli.contracts import Block, Method, Sampler, Scheme, Top
from topcli.engine.fingerprint import fingerprint
from topcli.errors import UsageError

if TYPE_CHECKING:
    from topcli.config.ensemble import EnsembleExperiment
    from topcli.engine.precise import PreciseRun


def method_fingerprint(method: Method) -> str:
    """Digest of the code of a scheme made ready for a top. Raises SchemeCodeError for code that cannot be hashed."""
    if isinstance(method, Sampler):
        return fingerprint(method.states, compiled=False)
    if isinstance(method, Block):
        code = method.text() + fingerprint(method.enter, compiled=False)
        layout = (method.width, method.counters, method.iterative)
    else:
        code = fingerprint(method.step, method.enter, method.leave, compiled=not method.plain)
        stages = method.stages and (fingerprint(method.stages[0]), method.stages[1])
        layout = (method.width, method.counters, method.iterative, method.checked, method.plain, stages)
    return hashlib.sha256((code + repr(layout)).encode()).hexdigest()


def scheme_code(scheme: Scheme, top: Top) -> str:
    """Digest of the code of a scheme with its default options; the reason if it cannot be built for ``top``."""
    try:
        return method_fingerprint(scheme.build(top, scheme.options()))
    except (UsageError, ValidationError) as error:
        return str(error)


@dataclass(frozen=True)
class Identity:
    """Resolved experiment or ensemble (``config``), the ``digest`` of what it computes, and that of the ``code``.

    Computed once for a run. Two runs are the same if both digests are equal.
    """

    config: dict[str, Any]
    digest: str
    code: str

    @classmethod
    def of(cls, experiment: Experiment | EnsembleExperiment, methods: Sequence[Method]) -> Identity:
        """Identity of an experiment under one method, or of an ensemble under those of its groups."""
        config = experiment.resolved()
        codes = [method_fingerprint(method) for method in methods]
        first = experiment if isinstance(experiment, Experiment) else experiment.first
        digest = digest_of(config, first.own_code)
        if isinstance(experiment, Experiment) and experiment.output.attitude:
            from topcli.engine.attitude import attitude_code

            code = f"{codes[0]},{attitude_code(experiment.top)}"
            return cls(config, digest, hashlib.sha256(code.encode()).hexdigest())
        code = codes[0] if len(codes) == 1 else hashlib.sha256(",".join(codes).encode()).hexdigest()
        return cls(config, digest, code)

    @property
    def name(self) -> str:
        """Name of the run and its folder."""
        return self.config["name"]

    @property
    def format(self) -> str:
        """Format of its tables, and their suffix."""
        return self.config["output"]["format"]

    @property
    def digests(self) -> dict[str, str]:
        """``digest`` and ``code``, as locks, checkpoints and manifests hold them."""
        return {"digest": self.digest, "code": self.code}

    def other_code(self, manifest: Mapping[str, Any]) -> str:
        """Reason why a run with an equal config has another digest, in half a line."""
        origins = [manifest.get("top_origin"), manifest.get("scheme_origin")]
        users = " and ".join(origin for origin in dict.fromkeys(origins) if origin not in (None, "topcli"))
        return f"computed by other code of {users}" if users else "identified by another version of topcli"

    def same(self, about: Mapping[str, Any]) -> bool:
        """True if ``about``, a manifest or the data of a checkpoint, has both digests."""
        return about.get("digest") == self.digest and about.get("code") == self.code


@dataclass(frozen=True)
class Prepared:
    """An experiment made ready: its ``identity``, and, unless it is an ensemble, its method and its other precision."""

    identity: Identity
    method: Method
    precise: PreciseRun | None = None


def prepared(experiment: Experiment | EnsembleExperiment, resume: bool = False) -> Prepared:
    """Make an experiment ready. Raises UsageError if it cannot be computed, or not resumed."""
    if isinstance(experiment, Experiment):
        method, precise = experiment.method(), precise_of(experiment)
        return Prepared(Identity.of(experiment, [method]), method, precise)
    if resume:
        raise UsageError("--resume works for runs of one trajectory; run the ensemble again without it")
    methods = [experiment.of_group(group).method() for group in experiment.members.groups]
    return Prepared(Identity.of(experiment, methods), methods[0])


def precise_of(experiment: Experiment) -> PreciseRun | None:
    """Prepare a run in another precision than double; None for double. Raises UsageError if the scheme has none."""
    if experiment.written is None:
        return None
    from topcli.runs.precise import precise_run

    return precise_run(experiment)
