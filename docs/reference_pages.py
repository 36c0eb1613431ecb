"""Pages of the reference that are written when the documentation is built, from the descriptors in the package.

One page for each scheme and each top (``descriptor_pages``), the keys of a config, the gallery of figures, the
integrable maps, and the bibliography. ``conf.py`` calls ``write_pages``; nothing that it writes is kept in the
repository.
"""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from pathlib import Path

from descriptor_pages import (
    Page,
    cost,
    file_of,
    grouped,
    kept,
    keys_of,
    order,
    own,
    scheme_page,
    spelled,
    symbols,
    table,
    top_page,
)

from topcli.studies.citations import bibliography, works_in
from topcli.tops import TOPS

ROOT = Path(__file__).resolve().parent.parent
IMAGES = ROOT / "docs" / "images"
DRAWN = ROOT / "results" / "figures"
"""Pictures that this checkout has drawn, for those that are not part of the documentation."""


def index_page(title: str, text: str, names: Sequence[str], rows: Page) -> Page:
    """Page that lists others."""
    return [f"# {title}", "", text, "", *rows, "```{toctree}", ":hidden:", "", *names, "```", ""]


def config_page() -> Page:
    """Keys of a config, from the models that read it."""
    from topcli.config.draws import Random
    from topcli.config.ensemble import Section
    from topcli.config.formulas import CustomSection
    from topcli.config.models import Config, Output, PoincareSection
    from topcli.config.ranges import Range

    header = ("key", "type", "default", "meaning")
    lines = [
        "# Keys of a config",
        "",
        "Generated from the models that read configs. A config is YAML or TOML; "
        "`topcli init` writes a commented one, `topcli schema` prints the JSON Schema, and every key can be replaced "
        "on the command line by `--set KEY=VALUE`. [Running experiments](../running.md) explains them by examples.",
        "",
        *table(header, keys_of(Config)),
    ]
    lines += ["## `output`", "", *table(header, keys_of(Output))]
    lines += [
        "## `section`",
        "",
        "One of `component` and `quantity`; see [Poincaré sections](../sections.md).",
        "",
        *table(header, keys_of(PoincareSection)),
    ]
    lines += [
        "## `ensemble`",
        "",
        "One of `states`, `grid` and `random`; see [Ensembles](../ensembles.md).",
        "",
        *table(header, keys_of(Section)),
        "A list of values in `grid` may be written as",
        "",
        *table(header, keys_of(Range)),
        "and `random` holds the way each vector is drawn and",
        "",
        *table(header, keys_of(Random)),
    ]
    lines += ["## `top`", "", "The kind alone, or a section with `kind` and these parameters:", ""]
    for top in TOPS.values():
        link = f"[{top.form}](tops/{file_of(top.form)}.md)"
        found = ", ".join(f"`{name}` = {spelled(field.default)}" for name, field in top.model_fields.items())
        lines += [f"- {link}: {found or 'no parameters'}"]
    lines += [
        "",
        "The kind `custom` declares [a top of your own](../own-top.md) by these keys:",
        "",
        *table(header, keys_of(CustomSection)),
        "## `scheme`",
        "",
        "The name alone, or a section with `name`, `compose` (a composition, where the scheme "
        "can be composed) and these options:",
        "",
    ]
    for name, schemes in grouped().items():
        found = ", ".join(
            f"`{key}` = {spelled(field.default)}" for key, field in schemes[0].options.model_fields.items()
        )
        if found:
            lines += [f"- [{name}](schemes/{name}.md): {found}"]
    return [*lines, ""]


def integrable_table() -> Page:
    """Table of the integrable maps of topcli."""
    rows = []
    for schemes in grouped().values():
        for one in schemes:
            if one.integrable is None:
                continue
            works = "; ".join(
                f"{work.surnames} {work.fields.get('year', '')}".strip() for work in works_in(one.citation)
            )
            integrals = ", ".join(filter(None, (kept(one), symbols(own(one)))))
            rows.append(
                (
                    f"[`{one.name}`](schemes/{one.name}.md), [{one.top}](tops/{file_of(one.top)}.md)",
                    integrals,
                    one.integrable.lax,
                    one.integrable.poisson,
                    order(one),
                    cost(one),
                    works,
                )
            )
    return table(("map", "integrals", "Lax pair", "Poisson", "order", "operations per step", "citation"), rows)


def integrable_page() -> Page:
    """Page of the integrable maps."""
    return [
        "# Integrable maps of topcli",
        "",
        "Maps whose orbits lie on tori (or curves), as those of the continuous top do: they conserve as many "
        "independent integrals, exactly or in modified form. Other schemes conserve fewer, or are not known to us to "
        "be integrable: a projection or a discrete gradient keeps the energy and k² of the Kowalevski top, but no "
        "Poisson bracket that we know of.",
        "",
        *integrable_table(),
        "For the Kowalevski top `backlund` is such a map; we know of no earlier one. It follows the general recipe of "
        "Kuznetsov and Vanhaecke (2000) with the Lax pair of Bobenko, Reyman and Semenov-Tian-Shansky (1989); "
        "[its derivation](../backlund.md). `hk` is not integrable for the Kowalevski top.",
        "",
        "The brackets called Lie-Poisson are tested numerically for each of these schemes. Operations per step are "
        "those of the default options at h = 0.01.",
        "",
    ]


def gallery_page(folder: Path) -> Page:
    """Every figure of the catalogue with the command that makes it; pictures are copied into ``folder``."""
    from topcli.figures.catalogue import FIGURES

    lines = [
        "# Gallery",
        "",
        "`topcli plot NAME` draws a figure and writes its data beside it; `make figures` draws all. "
        "[Figures](../figures.md) explains the options.",
        "",
    ]
    for name, figure in FIGURES.items():
        lines += [f"## {name}", "", f"{figure.title}.", "", "```sh", f"topcli plot {name}", "```", ""]
        source = next((path for path in (DRAWN / f"{name}.png", IMAGES / f"{name}.png") if path.is_file()), None)
        if source is not None:
            shutil.copyfile(source, folder / f"{name}.png")
            lines += [f"![{figure.title}]({name}.png)", ""]
        made = f"From `{figure.scene}`" if figure.scene.startswith("topcli ") else f"From the scene `{figure.scene}`"
        lines += [f"{made}." + ("" if source else " The picture appears here once it is drawn: `make figures`."), ""]
    return lines


def bibliography_page() -> Page:
    """All works, with the command that prints their BibTeX."""
    works = sorted(bibliography().values(), key=lambda one: (one.surnames, one.fields.get("year", "")))
    return [
        "# Bibliography",
        "",
        "`topcli cite` prints the BibTeX of topcli and of the paper, `topcli cite NAME` that of a scheme or a top.",
        "",
        *(f"- {one.text}" for one in works),
        "",
    ]


def pages(folder: Path) -> dict[str, Page]:
    """Content of each page by its path in ``folder``."""
    groups = grouped()
    found = {f"schemes/{name}.md": scheme_page(schemes) for name, schemes in groups.items()}
    found |= {f"tops/{file_of(form)}.md": top_page(top) for form, top in TOPS.items()}
    rows = [
        (
            f"[`{name}`](schemes/{name}.md)",
            schemes[0].title,
            ", ".join(one.top for one in schemes),
            ", ".join(dict.fromkeys(order(one) for one in schemes)),
        )
        for name, schemes in groups.items()
    ]
    found["schemes.md"] = index_page(
        "Schemes, one page each",
        "[Which scheme when](../which-scheme.md) helps to choose; [one page](../schemes.md) has them all.",
        [f"schemes/{name}" for name in groups],
        table(("scheme", "", "tops", "order"), rows),
    )
    rows = [
        (f"[`{form}`](tops/{file_of(form)}.md)", top.title, symbols(top.new().invariants()))
        for form, top in TOPS.items()
    ]
    found["tops.md"] = index_page(
        "Tops, one page each",
        "[Tops](../tops.md) introduces them.",
        [f"tops/{file_of(form)}" for form in TOPS],
        table(("top", "", "integrals"), rows),
    )
    found |= {
        "config.md": config_page(),
        "integrable.md": integrable_page(),
        "gallery.md": gallery_page(folder),
        "bibliography.md": bibliography_page(),
    }
    return found


def write_pages(folder: Path) -> list[Path]:
    """Write all pages into ``folder``, remove those that are no longer made, and return their paths.

    A page whose text is unchanged is not written again, so that it is not built again.
    """
    folder.mkdir(parents=True, exist_ok=True)
    written = []
    for name, lines in pages(folder).items():
        path = folder / name
        text = "\n".join(lines).rstrip() + "\n"
        path.parent.mkdir(exist_ok=True)
        if not path.is_file() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")
        written.append(path)
    for path in folder.rglob("*.md"):
        if path not in written:
            path.unlink()
    return written
