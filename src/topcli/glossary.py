"""Glossary: one name, label, symbol, unit and meaning for each quantity of topcli, and the words of its reports.

``topcli run``, comparisons, sweeps, JSON, DataFrames and tables use the same name for a quantity. A name that ends in
``.NAME`` stands for a family of names: ``drift.energy`` is the drift of the energy. In the row of an invariant, which
already names the invariant, the key is the first part alone: ``drift``.

The page ``glossary`` of the documentation is generated from this module.
"""

from __future__ import annotations

from dataclasses import dataclass

FAMILY = ".NAME"
"""End of the name of a family."""


@dataclass(frozen=True)
class Term:
    """A word of topcli; a quantity also has a label for tables, a symbol and a unit.

    Attributes
    ----------
    name : str
        Name in JSON, Python, sweeps and tables.
    meaning : str
        Definition, without a full stop.
    label : str
        Words for headings of tables; ``{}`` marks the place where "of E" is inserted, by default the end.
    symbol : str
        Symbol in LaTeX, without dollars; empty if the field has none.
    unit : str
        Unit in words; all physical quantities are dimensionless.
    """

    name: str
    meaning: str
    label: str = ""
    symbol: str = ""
    unit: str = ""

    @property
    def key(self) -> str:
        """Name without the end of a family."""
        return self.name.removesuffix(FAMILY)


NUMBER, TIME, OF_NAME = "number", "time", "unit of NAME"
PER_TIME = "unit of NAME per time"
OF_STATE = "unit of the state"


def _of_invariant(key: str, meaning: str, label: str, symbol: str, unit: str = OF_NAME) -> Term:
    return Term(key + FAMILY, meaning, label, symbol, unit)


_QUANTITIES = (
    # errors of the state
    Term(
        "max_error",
        "largest distance of a recorded state from the reference solution",
        "max error",
        r"\max_n \Vert y_n - y(t_n) \Vert",
        OF_STATE,
    ),
    Term(
        "final_error",
        "distance of the last state from the reference solution",
        "final error",
        r"\Vert y_N - y(t_N) \Vert",
        OF_STATE,
    ),
    Term(
        "reversal_defect",
        "difference between a state and the result of one step of |h| forward and one step back from it; the largest "
        "over 16 states of the run",
        "reversal defect",
        r"\max \Vert \Phi_{-h}(\Phi_h(y)) - y \Vert_\infty",
        OF_STATE,
    ),
    Term(
        "reversal_order", "power of h with which the reversal defect falls", "order of the reversal defect", "", NUMBER
    ),
    # invariants and other columns
    _of_invariant("first", "value of NAME at step 0", "first value", "I_0"),
    _of_invariant("last", "value of NAME in the last recorded row", "last value", "I_N"),
    _of_invariant("min", "smallest value of NAME over the recorded rows", "min", r"\min_n I_n"),
    _of_invariant("max", "largest value of NAME over the recorded rows", "max", r"\max_n I_n"),
    _of_invariant("mean", "mean of NAME over the recorded rows", "mean", r"\bar I"),
    _of_invariant(
        "max_deviation", "largest deviation of NAME from its first value", "max deviation", r"\max_n |I_n - I_0|"
    ),
    _of_invariant(
        "max_deviation_relative",
        "largest deviation of NAME divided by the magnitude of its first value; missing if the first value is 0",
        "max deviation, relative",
        r"\max_n |I_n - I_0| / |I_0|",
        NUMBER,
    ),
    _of_invariant(
        "rms_deviation",
        "root mean square of the deviation of NAME from its first value",
        "rms deviation",
        r"\langle (I_n - I_0)^2 \rangle^{1/2}",
    ),
    _of_invariant(
        "rms_deviation_relative",
        "root mean square of the deviation of NAME divided by the magnitude of its first value",
        "rms deviation, relative",
        r"\langle (I_n - I_0)^2 \rangle^{1/2} / |I_0|",
        NUMBER,
    ),
    _of_invariant(
        "final_deviation", "deviation of NAME in the last state, with its sign", "final deviation", r"I_N - I_0"
    ),
    _of_invariant(
        "drift", "slope of a line fitted to NAME, per unit time", "drift{} per unit time", r"\dot I", PER_TIME
    ),
    _of_invariant(
        "drift_error",
        "standard error of the drift of NAME",
        "standard error of the drift{}",
        r"\sigma_{\dot I}",
        PER_TIME,
    ),
    _of_invariant(
        "drift_bound",
        "upper bound of the magnitude of the mean rate of change of NAME, with 95 % confidence",
        "95 % bound of the drift{}",
        r"|\dot I|_{95\,\%}",
        PER_TIME,
    ),
    _of_invariant("drift_over_run", "drift of NAME times the length of the run", "drift{} over the run", r"\dot I T"),
    _of_invariant(
        "round_off_bound",
        "largest deviation of NAME that round-off can explain",
        "round-off bound",
        r"20 u \sqrt N s_I",
    ),
    # swings and frequencies
    Term("swings", "number of swings, which are deep minima of one component of the state", "swings", "", NUMBER),
    Term(
        "first_swing_spacing",
        "time from the first swing to the second",
        "first swing spacing",
        "t_2 - t_1",
        TIME,
    ),
    Term(
        "median_swing_spacing",
        "median time from one swing to the next",
        "median swing spacing",
        r"\mathrm{med}_i (t_{i+1} - t_i)",
        TIME,
    ),
    _of_invariant(
        "frequency",
        "frequency of the strongest spectral line of NAME in the recorded rows",
        "frequency",
        "f",
        "cycles per unit time",
    ),
    _of_invariant("period", "time of one oscillation of NAME in the exact motion", "period", "T_I", TIME),
    _of_invariant(
        "digits",
        "number of decimal digits in which the weighted averages of NAME over the two halves of the run agree",
        "digits",
        "",
        NUMBER,
    ),
    Term("lyapunov", "largest Lyapunov exponent, after a transient", "Lyapunov exponent", r"\lambda", "inverse time"),
    Term("chaotic", "1 for a chaotic orbit, 0 for a regular one or a point; otherwise missing", "chaotic", "", NUMBER),
    # work
    _of_invariant("counter", "number of events called NAME that the scheme counted", "counter", "", NUMBER),
    Term("steps", "number of steps taken; for a failed run, the number of the step that failed", "steps", "n", NUMBER),
    Term(
        "seconds",
        "wall time of the steps; runs that are computed together in a batch share its time equally; not reproducible",
        "seconds",
        "",
        "seconds",
    ),
    Term("nanoseconds_per_step", "wall time of one step", "ns per step", "", "nanoseconds"),
)
QUANTITIES = {term.key: term for term in _QUANTITIES}
"""Quantities by name; families without their end."""


def label(key: str, of: str = "") -> str:
    """Heading of a quantity ``of`` something, given in words or symbols: "drift of E per unit time"."""
    words = QUANTITIES[key].label
    return (words if "{}" in words else words + "{}").format(f" of {of}" if of else "")


def definition(name: str) -> tuple[str, str]:
    """Meaning of a quantity such as ``drift.energy``, and its symbol in LaTeX; both empty for any other name."""
    key, _, of = name.partition(".")
    term = QUANTITIES.get(key)
    return ("", "") if term is None else (term.meaning.replace("NAME", of or "NAME"), term.symbol)


def in_words(name: str) -> str:
    """Heading of a quantity such as ``drift.energy``; any other name as it is."""
    key, _, of = name.partition(".")
    return label(key, of) if key in QUANTITIES else name


_WORDS = (
    Term(
        "adaptive scheme",
        "a scheme that chooses the lengths of its internal steps from an error tolerance; it still gives a state at "
        "every multiple of h",
    ),
    Term("attitude", "the rotation from a frame fixed in the body to a frame fixed in space"),
    Term(
        "bound",
        "a number that the mean rate of change of an invariant over a run does not exceed in magnitude, with 95 % "
        "confidence; the verdict `no drift seen` is printed with this number",
    ),
    Term("claim", "a statement of the paper that `topcli claims` tests by computation"),
    Term(
        "composition",
        "a scheme of higher order made of several steps of a self-adjoint scheme, such as `hk+kahan-li8`",
    ),
    Term(
        "config",
        "a file in YAML or TOML that describes an experiment: top, scheme, step size h, number of steps N and initial "
        "state",
    ),
    Term("deviation", "the value of an invariant minus its first value in the run"),
    Term("drift", "the slope of a line fitted to the deviation of an invariant, per unit time"),
    Term("ensemble", "an experiment with many initial states, all with the same scheme and step size"),
    Term(
        "HK",
        "the Hirota-Kimura scheme, also called Kahan's method: each product xy in the equations of motion becomes "
        "(x y′ + x′ y)/2, where x and y are values before the step, and x′ and y′ values after it; each step solves "
        "one linear system",
    ),
    Term(
        "digest", "a hash of everything that defines an experiment; topcli distinguishes experiments by their digests"
    ),
    Term("hard case", "an experiment in which schemes may fail; `topcli stress` runs the hard cases"),
    Term("invariant", "a function of the state that the exact motion keeps constant, such as the energy E"),
    Term("measure", "a number that a sweep computes for each run, such as the drift of the energy"),
    Term(
        "modified integral",
        "a function of the state and of h, close to an invariant, that the scheme conserves instead of the invariant",
    ),
    Term(
        "order",
        "the power p of the step size h in the error of a scheme: for small h, the error is about a constant times h^p",
    ),
    Term(
        "reference solution",
        "the exact motion, computed from a closed form or by Taylor series in double-double arithmetic (32 digits)",
    ),
    Term(
        "round-off",
        "the effect of rounding to doubles; topcli ascribes deviations of an invariant below its `round_off_bound` "
        "(defined under Quantities) to round-off",
    ),
    Term("scene", "a config that comes with topcli and can be run by its name; `topcli list scenes` lists all scenes"),
    Term("scheme", "a numerical method that takes the state at time t to the state at time t + h"),
    Term(
        "self-adjoint",
        "a property of schemes: a step of -h undoes a step of h; also called symmetric or time-reversible",
    ),
    Term(
        "swing",
        "one fall and rise of the top; a swing is timed at a minimum of one component of the state (gamma1 for the "
        "Kowalevski top, omega2 for the Euler top) that lies below the middle between the smallest and the largest "
        "value of this component",
    ),
    Term(
        "sweep",
        "a set of runs, one for every combination of given values of config keys, with the measures of each run",
    ),
    Term("top", "a system of equations of motion with its parameters and invariants"),
    Term(
        "verdict",
        "the judgement on an invariant in a run: `exact`, `no drift seen`, `drifting`, `undecided`, `lost` or "
        "`unjudged`; for a claim or a check, the result of the test, such as `holds`",
    ),
    Term("exact", "verdict on an invariant: the invariant deviates from its first value by no more than round-off"),
    Term(
        "no drift seen",
        "verdict on an invariant: it deviates by more than round-off, but its drift is not statistically significant; "
        "the 95 % bound of the drift is given",
    ),
    Term(
        "drifting",
        "verdict on an invariant: its drift is statistically significant; the drift is given with its 95 % interval",
    ),
    Term(
        "undecided",
        "verdict on an invariant: the run is too short to tell whether the invariant drifts; the shortest length of a "
        "run that may suffice is given",
    ),
    Term("lost", "verdict on an invariant: its deviation exceeds a quarter of its first value"),
    Term(
        "unjudged",
        "no verdict is possible: the values of the invariant are not finite, no step was recorded, or the exact motion "
        "does not conserve the quantity for these initial values",
    ),
)
WORDS = {term.name: term for term in _WORDS}
"""Words of reports and of the documentation."""
