"""Identity of a run: the digest of its computation, and the digest of the code that carries it out.

What a run computes and records is its resolved config without the name and the format of the series: top and
parameters, initial state or ensemble, scheme and options, h, N, recorded rows and columns. A name says where a run is
stored, and every format holds the same bits. The code is the text of the files that the top and the scheme import,
directly or not, in the packages of topcli that make numbers, and of a user's own files. A comment in one of these files
makes it other code; a change elsewhere, as in the command line or the figures, does not.
"""

from __future__ import annotations

from topcli.config.models import Experiment, digest_of
from topcli.contracts import Scheme, Top
from topcli.plugins import own_sources
from topcli.store.result_folder import Identity
from topcli.store.sources import source_digest

LOOPS = ("topcli.engine.machine", "topcli.engine.integration", "topcli.schemes.registry")
"""Modules with the time loops of all schemes, and with the wrappers of their steps."""


def code_digest(top: type[Top], scheme: Scheme, *modules: str) -> str:
    """Digest of the source code that computes states of a top under a scheme, also in further ``modules``.

    Raises SchemeCodeError for code without a file.
    """
    makers = top.__module__, scheme.maker.__module__
    return source_digest((*LOOPS, *makers, *modules), tuple(own_sources(top, scheme).values()))


def identity_of(experiment: Experiment) -> Identity:
    """Identity of an experiment or an ensemble. Raises SchemeCodeError for code without a file."""
    config = experiment.resolved()
    parts = {
        "engine.attitude": experiment.output.attitude,
        "engine.numbers": experiment.written,
        "analysis.crossings": experiment.crossings,
    }
    modules = [f"topcli.{module}" for module, needed in parts.items() if needed]
    code = code_digest(type(experiment.top), experiment.scheme, *modules)
    return Identity(config, digest_of(config, experiment.own_code), code)
