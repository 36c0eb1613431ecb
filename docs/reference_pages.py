"""Pages of the reference that are written when the documentation is built, from the descriptors in the package.

One page for each scheme and each top (``descriptor_pages``), each figure and each object of the Python interface
(``object_pages``), files of the root of the checkout, and the parts that pages in ``docs/`` include, such as the
commands (``command_pages``). ``conf.py`` calls ``write_pages``; nothing that it writes is kept in the repository.
"""

from __future__ import annotations

import re
import shutil
import tomllib
from pathlib import Path

from command_pages import commands_page
from descriptor_pages import (
    Page,
    anchor,
    file_of,
    grouped,
    indexed,
    kept,
    keys_of,
    linked,
    order,
    own,
    scheme_page,
    shown_on,
    spelled,
    symbols,
    table,
    top_page,
)
from glossary_page import quantities, words
from object_pages import object_files, object_page, object_table
from scheme_pictures import draw_if_old

from topcli.figures.figure import Figure
from topcli.studies.citations import bibliography, works_in
from topcli.tops import TOPS

ROOT = Path(__file__).resolve().parent.parent
IMAGES = ROOT / "docs" / "images"
DRAWN = ROOT / "results" / "figures"
"""Pictures that this checkout has drawn, for those that are not part of the documentation."""
LISTS = ("schemes", "tops", "which-scheme", "catalogue")
"""Pages that list schemes."""


def config_page() -> Page:
    """Keys of a config, from the models that read it."""
    from topcli.config.draws import Random
    from topcli.config.ensemble import Section
    from topcli.config.formulas import CustomSection
    from topcli.config.models import Config, Output, PoincareSection
    from topcli.config.ranges import Range

    header = ("key", "type", "default", "meaning")
    lines = table(header, keys_of(Config))
    lines += ["## `output`", "", *table(header, keys_of(Output))]
    lines += [
        "## `section`",
        "",
        "These are the keys of a Poincaré section ([Poincaré sections](sections.md)). Give either `component` or "
        "`quantity`.",
        "",
        *table(header, keys_of(PoincareSection)),
    ]
    lines += [
        "## `ensemble`",
        "",
        "These are the keys of an ensemble ([Ensembles](ensembles.md)). Give one of `states`, `grid` and `random`.",
        "",
        *table(header, keys_of(Section)),
        "In `grid`, evenly spaced values can be written as a range, which is a section with these keys:",
        "",
        *table(header, keys_of(Range)),
        "The section `random` has a key for each vector, which says how the vector is drawn, and these keys:",
        "",
        *table(header, keys_of(Random)),
    ]
    lines += [
        "## `top`",
        "",
        "Give the kind of the top alone, or a section with `kind` and the parameters of the top. The page of each top "
        "([Tops](tops.md)) explains the parameters. The kinds and the default values of their parameters are:",
        "",
    ]
    for top in TOPS.values():
        found = ", ".join(f"`{name}` = {spelled(field.default)}" for name, field in top.model_fields.items())
        lines += [f"- `{top.form}`: {found or 'no parameters'}"]
    lines += [
        "",
        "The kind `custom` declares [a top of your own](own-top.md). It has these keys:",
        "",
        *table(header, keys_of(CustomSection)),
        "## `scheme`",
        "",
        "Give the name of the scheme alone, or a section with `name` and options. A scheme that can be composed also "
        "takes the key `compose`, whose value is the name of a [composition](higher-order.md). The page of each scheme "
        "([Schemes](schemes.md)) explains its options. These schemes have options (with their default values):",
        "",
    ]
    for name, schemes in grouped().items():
        found = ", ".join(
            f"`{key}` = {spelled(field.default)}" for key, field in schemes[0].options.model_fields.items()
        )
        if found:
            lines += [f"- `{name}`: {found}"]
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
                    works,
                )
            )
    return table(("map", "integrals", "Lax pair", "Poisson bracket", "order", "citation"), rows)


def integrable_page() -> Page:
    """Page of the integrable maps."""
    return [
        "# Integrable maps of topcli",
        "",
        "A step of a scheme is a map of states. The orbits of an integrable map lie on tori (or curves), like those "
        "of the continuous top. Such a map conserves as many independent integrals as the top, exactly or in modified "
        "form. Other schemes conserve fewer integrals, or we do not know whether they are integrable. A projection or "
        "a discrete gradient, for example, conserves the energy and k² of the Kowalevski top, but no Poisson bracket "
        "that we know of. In the table, a tilde marks the modified form of an integral. The page [What "
        "HK conserves with gamma](../hk-gamma.md) defines K, J, G, $K_i$ and $\\alpha_k$; $\\kappa_{ij}$ is "
        "$(K_i/K_j - 1)$ divided by $(h/2)^2\\alpha_k$. L is a Lax matrix before a step, and L' is the same "
        "matrix after it.",
        "",
        *integrable_table(),
        "For the Kowalevski top, `backlund` is an integrable map; we know of no earlier one. [Its "
        "derivation](../backlund.md) follows the general recipe of Kuznetsov and Vanhaecke (2000) with the Lax pair of "
        "Bobenko, Reyman and Semenov-Tian-Shansky (1989). `hk` is not integrable for the Kowalevski top.",
        "",
        "The tests of topcli check numerically that each of these schemes preserves the bracket that the table calls "
        "Lie-Poisson.",
        "",
    ]


def picture_of(name: str) -> Path | None:
    """Picture of a figure: the one that this checkout has drawn, or that of the documentation."""
    return next((path for path in (DRAWN / f"{name}.png", IMAGES / f"{name}.png") if path.is_file()), None)


def figure_page(name: str, figure: Figure) -> Page:
    """Page of one figure of the catalogue."""
    lines = [
        f"# {name}",
        "",
        *indexed(f"figure {name}", name),
        f"*{figure.title}.*",
        "",
        "```sh",
        f"topcli plot {name}",
        "```",
        "",
    ]
    if picture_of(name):
        lines += [f"![{figure.title}]({name}.png)", ""]
    else:
        lines += [f"This build of the documentation has no picture of it. `topcli plot {name}` draws it.", ""]
    made = f"From `{figure.scene}`" if figure.scene.startswith("topcli ") else f"From the scene `{figure.scene}`"
    return [*lines, f"{made}. The page [Figures](../../figures.md) explains the options of the command.", ""]


def gallery(folder: Path) -> Page:
    """Thumbnails and titles of all figures; pictures and thumbnails are written into ``folder``."""
    from PIL import Image

    from topcli.figures.catalogue import FIGURES

    (folder / "figures").mkdir(exist_ok=True)
    lines = ["````{container} gallery"]
    for name, figure in FIGURES.items():
        lines += ["```{container} card"]
        if source := picture_of(name):
            shutil.copyfile(source, folder / "figures" / f"{name}.png")
            with Image.open(source) as picture:
                small = picture.convert("RGB")
                small.thumbnail((480, 480))
                small.save(folder / "figures" / f"{name}.small.png")
            lines += [f"[![{figure.title}](reference/figures/{name}.small.png)](reference/figures/{name}.md)", ""]
        lines += [f"[**{name}**](reference/figures/{name}.md) {figure.title}", "```"]
    return [*lines, "````", ""]


def bibliography_entries() -> Page:
    """All works, with what cites them and what could not be checked."""
    citing: dict[str, list[str]] = {}
    for name, schemes in grouped().items():
        for work in {work.key: work for one in schemes for work in works_in(one.citation)}.values():
            citing.setdefault(work.key, []).append(name)
    for top in TOPS.values():
        for work in works_in(top.citation):
            citing.setdefault(work.key, []).append(top.form)
    lines: Page = []
    for one in sorted(bibliography().values(), key=lambda one: (one.surnames, one.fields.get("year", ""))):
        cited = ", ".join(f"`{name}`" for name in dict.fromkeys(citing.get(one.key, ())))
        about = f"Cited by {cited}." if cited else "Cited on other pages of this documentation."
        if "not checked" in one.fields.get("note", "").lower():
            about += " **Not checked in full.**"
        lines += [f"({anchor(one)})=", f"{linked(one)}\\", about, ""]
    return lines


def root_page(name: str) -> Page:
    """Page of a file in the root of the checkout; its links to pages lead there, other files are named."""
    text = re.sub(r"\]\(docs/", "](../", (ROOT / name).read_text(encoding="utf-8"))
    return [re.sub(r"\[([^\]]+)\]\((?!\.\./|https?:|#)([^)]+)\)", r"\1 (`\2`)", text)]


def requirements() -> Page:
    """Versions of Python and of packages that topcli needs, from the metadata of the project."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    versions = [one.rpartition(" ")[2] for one in project["classifiers"] if "Python :: 3." in one]
    extras = [(f"`{name}`", ", ".join(found)) for name, found in project["optional-dependencies"].items()]
    return [
        f"Python {versions[0]} to {versions[-1]}. `pip install .` installs these packages:",
        "",
        *(f"- {one}" for one in project["dependencies"]),
        "",
        "Extras such as `pip install '.[video]'` add packages:",
        "",
        *table(("extra", "packages"), extras),
    ]


def pages(folder: Path) -> dict[str, Page]:
    """Content of each page by its path in ``folder``."""
    from topcli.figures.catalogue import FIGURES

    found = {f"schemes/{name}.md": scheme_page(schemes) for name, schemes in grouped().items()}
    found |= {f"tops/{file_of(form)}.md": top_page(top) for form, top in TOPS.items()}
    found |= {f"figures/{name}.md": figure_page(name, figure) for name, figure in FIGURES.items()}
    found |= {f"api/{file}.md": object_page(name) for name, file in object_files().items()}
    return found | {
        "integrable.md": integrable_page(),
        "changelog.md": root_page("CHANGELOG.md"),
        "contributing.md": root_page("CONTRIBUTING.md"),
        "parts/commands.md": commands_page(),
        "parts/words.md": words(),
        "parts/quantities.md": quantities(),
        "parts/config.md": config_page(),
        "parts/gallery.md": gallery(folder),
        "parts/bibliography.md": bibliography_entries(),
        "parts/api.md": object_table(),
        "parts/requirements.md": requirements(),
    }


def named_pages(page: str) -> dict[str, str]:
    """Pages of schemes, tops and objects of Python by their names, for links from ``page``.

    ``exact`` is a verdict as well as a scheme, and a link only on pages that list schemes.
    """
    names = {f"topcli.{name}": f"reference/api/{file}" for name, file in object_files().items()}
    names |= {form: f"reference/tops/{file_of(form)}" for form in TOPS}
    names |= {name: f"reference/schemes/{name}" for name in grouped()}
    if page not in LISTS and not page.startswith("reference/tops/"):
        del names["exact"]
    return names


def write_pages(folder: Path) -> list[Path]:
    """Write all pages and the pictures of schemes into ``folder``; remove pages that are no longer made.

    Returns the paths of the pages. A page whose text is unchanged is not written again, so that it is not built again.
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


def draw_schemes(folder: Path) -> None:
    """Draw the pictures of the pages of schemes."""
    for name, schemes in grouped().items():
        draw_if_old(shown_on(schemes), folder / "schemes" / f"{name}.png")
