"""Studies: the work behind the commands that measure, such as compare, bench and stress.

Their names and observers are here, where the start of the command line finds them without importing a study.
"""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    from topcli.studies.study import Study


class Watch:
    """Observer of a study while it runs; this one is silent. It is called with (done, total) as the study proceeds."""

    def begin(self, name: str, *experiments: Any, file: Path | None = None) -> None:
        """Note that the ``experiments`` are run from now on, and that the result is stored in ``file``.

        Everything that the user gave is checked before.
        """

    def message(self, line: str) -> None:
        """Note something that the user should know at once."""

    def __call__(self, done: int, total: int, note: str = "") -> None:
        """Note that ``done`` of ``total`` are done."""


SILENT = Watch()


class StudyPlace(NamedTuple):
    """Place where a study is declared, and the first line of its help, which needs no import."""

    place: str
    help: str


STUDIES = {
    "compare": StudyPlace(
        "topcli.studies.compare:COMPARE", "Compare errors, drifts, reversibility and speed of schemes."
    ),
    "analyse": StudyPlace("topcli.studies.analyse:ANALYSE", "Analyse a time series that another program computed."),
    "lax": StudyPlace("topcli.studies.lax:LAX", "Check Lax forms (pairs L, M) of a top and the spectrum of L."),
    "check": StudyPlace("topcli.studies.check:CHECK", "Check the declared properties of schemes and tops."),
    "integrability": StudyPlace(
        "topcli.studies.integrability:INTEGRABILITY", "Collect evidence on the integrability of a scheme's map."
    ),
    "roundoff": StudyPlace(
        "topcli.studies.roundoff:ROUNDOFF", "Measure growth of round-off, and cost of compensated sums."
    ),
    "stress": StudyPlace("topcli.studies.stress.study:STRESS", "Test schemes in hard cases and find what breaks."),
    "claims": StudyPlace("topcli.paper.study:CLAIMS", "Test the claims of the paper by experiments."),
    "lyapunov": StudyPlace("topcli.studies.lyapunov:LYAPUNOV", "Measure Lyapunov exponents and detect chaos."),
    "frequencies": StudyPlace(
        "topcli.studies.frequencies:FREQUENCIES", "Measure the frequencies of an orbit and detect chaos."
    ),
    "order": StudyPlace("topcli.studies.order:ORDER", "Measure errors at several h, and orders of convergence."),
}
"""All studies by name."""


def find_study(name: str) -> Study:
    """Return the study called ``name``."""
    return imported(STUDIES[name].place)


def imported(place: str) -> Any:
    """Object called ``module:name``."""
    module, _, name = place.partition(":")
    return getattr(import_module(module), name)
