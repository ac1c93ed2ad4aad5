"""Hook of mkdocs: pages from outside docs/, links that leave docs/, and the reference of commands and effects.

The pages in docs/ link to each other and to files of the repository by relative path, so that they can be read on their
own. For the site this hook adds the linked Markdown files from outside docs/, and prints a link to any other file as
its path.
"""

from __future__ import annotations

import logging
import os
import posixpath
import re
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from mkdocs.config.defaults import MkDocsConfig
    from mkdocs.structure.files import Files
    from mkdocs.structure.pages import Page

ROOT = Path(__file__).resolve().parent.parent
LOG = logging.getLogger("mkdocs.hooks.site_pages")

ADDED = {
    "CHANGELOG.md": "changelog.md",
    "CONTRIBUTING.md": "contributing.md",
    "README.md": "index.md",
    "assets/depth/README.md": "assets/depth.md",
    "examples/videos/README.md": "examples/videos.md",
    "lab/README.md": "lab/index.md",
    "lab/people/README.md": "lab/people.md",
    **{f"policies/{card.name}": f"policies/{card.name}" for card in (ROOT / "policies").glob("*.md")},
    **{f"lab/results/{page.name}": f"results/{page.name}" for page in (ROOT / "lab" / "results").glob("*.md")},
}
"""Where the site has a Markdown file from outside docs/. README.md stands for the site's own first page."""

COMMANDS = "<!-- commands -->"
"""Mark in docs/reference/commands.md that the help of every command replaces."""

EFFECTS = "<!-- effects -->"
"""Mark in docs/reference/effects.md that a section for each effect replaces."""

_LINK = re.compile(r"(!?)\[(?P<text>[^\]]*)\]\((?P<path>[^)\s#]*)(?P<anchor>#[^)\s]*)?\)")

_PLAIN_BRACKET = re.compile(r"\[(?!`[^`]*`\]\(#)")
"""A bracket of a unit or a default in the help, not of a link."""


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages from outside docs/."""
    from mkdocs.structure.files import File

    for source, target in ADDED.items():
        if target != "index.md":
            text = (ROOT / source).read_text(encoding="utf-8")
            files.append(File.generated(config, target, content=text))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Resolve the links of a page and fill in the command reference."""
    path = page.file.src_uri
    if COMMANDS in markdown:
        markdown = markdown.replace(COMMANDS, command_reference())
    if EFFECTS in markdown:
        markdown = markdown.replace(EFFECTS, effect_reference())
    return site_links(markdown, path)


def site_links(markdown: str, page: str) -> str:
    """Return a page whose relative links are right on the site.

    Args:
        markdown: Text of the page.
        page: Path of the page inside the site, such as `manual/robot.md`.
    """
    outside = {target: source for source, target in ADDED.items() if target != "index.md"}
    source = outside.get(page, f"docs/{page}")

    def replaced(match: re.Match[str]) -> str:
        path = match["path"]
        if not path or "://" in path or path.startswith("mailto:"):
            return match[0]
        wanted = posixpath.normpath(posixpath.join(posixpath.dirname(source), path))
        if not (ROOT / wanted).exists():
            LOG.warning("%s links to %s, which does not exist", source, path)
            return match[0]
        target = ADDED.get(wanted, wanted.removeprefix("docs/") if wanted.startswith("docs/") else None)
        if target is None and wanted.endswith(".md"):
            LOG.warning("%s links to %s, which is no page of the site: add it to ADDED", source, path)
        if target is None:
            return match["text"] if match["text"].startswith("`") else f"`{match['text']}`"
        relative = posixpath.relpath(target, posixpath.dirname(page) or ".")
        return f"{match[1]}[{match['text']}]({relative}{match['anchor'] or ''})"

    return _LINK.sub(replaced, markdown)


def command_reference() -> str:
    """Return the help of every command as Markdown, with headings from the second level on."""
    os.environ.setdefault("COLUMNS", "120")
    from mimic.cli.app import app
    from mimic.cli.play import play

    if not app.default_command:
        app.default(play)
    text = app.generate_docs(output_format="markdown", heading_level=2)
    text = re.sub(r"^#+ Table of Contents\n.*?\n(?=\*\*)", "", text, count=1, flags=re.M | re.S)
    text = re.sub(r"(?<!`)``(?!`)", "`", text).replace("\\[", "[")
    lines = [
        line.strip() if line.lstrip().startswith("mimic ") else _PLAIN_BRACKET.sub(r"\\[", line)
        for line in text.splitlines()
    ]
    text = "\n".join(lines)
    return re.sub(r"\n {4,}(?=\S)", "\n    ", text)


def effect_reference() -> str:
    """Return a section in Markdown for each effect of the catalogue."""
    from mimic.config.sysid import CalibrateSettings
    from mimic.dynamics.catalogue import CATALOGUE

    sections = []
    for effect in CATALOGUE.values():
        marks = {
            "baseline": effect.name in CalibrateSettings().baseline,
            "always refitted": effect.structural,
            "read from the log": effect.random,
            "read from the positions": effect.read_off and not effect.random,
        }
        items = {
            "Equation": f"`{effect.equation}`",
            "Residual": effect.signature,
            "Best excitation": effect.experiment,
            "In MuJoCo": effect.enters,
            "Source": effect.source,
            "Fit": ", ".join(text for text, applies in marks.items() if applies),
        }
        lines = [f"* {key}: {text.rstrip('.')}." for key, text in items.items() if text]
        sections.append("\n".join([f"### {effect.name}", "", *lines]))
    return "\n\n".join(sections)
