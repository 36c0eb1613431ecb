"""Display names of the schemes, such as HK, Bohlin A and hybrid, grouped into families of related schemes."""

from __future__ import annotations

FAMILIES: tuple[dict[str, str], ...] = (
    {"hk": "HK", "hk-exact": "HK in closed form", "hk:project=1": "HK, projected"},
    {"bohlin-a": "Bohlin A", "bohlin-b": "Bohlin B", "bohlin-c": "Bohlin C", "bs": "BS", "bs-implicit": "implicit BS"},
    {"midpoint": "midpoint"},
    {"rk2": "RK2", "rk4": "RK4", "taylor": "Taylor", "dop853": "DOP853"},
    {"hybrid": "hybrid", "hybrid-sym": "sym. hybrid"},
    {"splitting": "splitting", "dmv": "DMV"},
    {
        "exact": "exact",
        "backlund:nodes=exact": "Bäcklund, exact nodes",
        "backlund": "Bäcklund",
    },
)
"""Name in configs and display name of each scheme and of variants that figures compare; a family has one colour."""
COMPOSED = {"yoshida4": "Yoshida 4", "suzuki4": "Suzuki 4", "kahan-li6": "Kahan-Li 6", "kahan-li8": "Kahan-Li 8"}
"""Display names of the compositions."""
_NAMES = {name: text for family in FAMILIES for name, text in family.items()}
"""Display name of each scheme."""


def display_name(label: str) -> str:
    """Name of a scheme as people read it.

    Parameters
    ----------
    label : str
        Name in configs, with a composition and settings or without: ``hk``, ``hk+suzuki4``, ``hk:h=0.1``.

    Returns
    -------
    str
        Display name with the composition after a plus sign and the settings in parentheses; any other label, such as
        the name of a scheme of your own, as it is.

    Examples
    --------
    >>> display_name("bohlin-a")
    'Bohlin A'
    >>> display_name("hk+suzuki4:h=0.1,N=20")
    'HK + Suzuki 4 (h=0.1, N=20)'
    >>> display_name("my-scheme:h=0.1")
    'my-scheme:h=0.1'
    """
    if label in _NAMES:
        return _NAMES[label]
    scheme, _, settings = label.partition(":")
    name, plus, composition = scheme.partition("+")
    if name not in _NAMES or (plus and composition not in COMPOSED):
        return label
    text = f"{_NAMES[name]} + {COMPOSED[composition]}" if plus else _NAMES[name]
    return f"{text} ({', '.join(settings.split(','))})" if settings else text
