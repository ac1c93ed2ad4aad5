"""The pages of docs/: their links, the command reference and the navigation of the site."""

from __future__ import annotations

import importlib.util
import re
from pathlib import Path
from types import ModuleType

import pytest
import yaml

import mimic
from mimic.cli.app import DEFAULTS, app
from mimic.dynamics.catalogue import CATALOGUE

ROOT = Path(__file__).parents[2]
PAGES = sorted(
    [*ROOT.glob("*.md"), *(p for name in ("docs", "lab", "policies", "examples") for p in (ROOT / name).rglob("*.md"))]
)


@pytest.fixture(scope="module")
def site() -> ModuleType:
    spec = importlib.util.spec_from_file_location("site_pages", ROOT / "docs" / "site_pages.py")
    assert spec
    assert spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def navigation(entry: object) -> list[str]:
    """Return the pages that a part of the navigation names."""
    if isinstance(entry, str):
        return [entry]
    parts = entry.values() if isinstance(entry, dict) else entry
    return [page for part in parts for page in navigation(part)]  # type: ignore[union-attr]


@pytest.mark.parametrize("page", PAGES, ids=lambda path: str(path.relative_to(ROOT)))
def test_every_relative_link_of_a_page_leads_to_a_file(page: Path) -> None:
    text = re.sub(r"```.*?```|`[^`\n]*`", "", page.read_text(encoding="utf-8"), flags=re.S)
    links = [
        link for link in re.findall(r"\]\(([^)\s#]+)", text) if "://" not in link and not link.startswith("mailto:")
    ]
    missing = [link for link in links if not (page.parent / link).exists() and link not in ("TARGET",)]
    assert missing == []


def test_the_command_reference_has_every_command_and_every_option(site: ModuleType) -> None:
    reference = site.command_reference()
    options = 0
    for name in [(), *((command,) for command in app if not command.startswith("-"))]:
        command = app[name[0]] if name else app
        subcommands = [command[sub] for sub in command if name and not sub.startswith("-")]
        for leaf in subcommands or [command]:
            for argument in (
                leaf.assemble_argument_collection(default_parameter=DEFAULTS).filter_by(parse=True)
                if leaf.default_command
                else ()
            ):
                for option in argument.names:
                    assert option.startswith("-") is False or option in reference, option
                    options += 1
        assert f"## {' '.join(('mimic', *name))}\n" in reference
    assert options > 100, "the walk over the commands found too little"


def test_the_effect_reference_has_every_effect_with_its_equation_and_source(site: ModuleType) -> None:
    reference = site.effect_reference()
    for name, effect in CATALOGUE.items():
        section = reference.split(f"### {name}\n")[1].split("###")[0]
        assert effect.equation in section
        assert effect.source.rstrip(".") in section


def test_the_reference_of_the_library_has_every_public_name() -> None:
    pages = "\n".join(p.read_text(encoding="utf-8") for p in (ROOT / "docs" / "reference" / "api").glob("*.md"))
    shown = dict(
        re.findall(
            r"^::: (\S+)\n(?:    options:\n(?:      (?!members).*\n)*(?:      members: \[(.*)\])?)?", pages, re.M
        )
    )
    for name in mimic.__all__:
        if name != "__version__":
            module = mimic._MODULE_OF[name]
            assert module in shown, f"{name} of {module} is on no page of the reference"
            assert not shown[module] or name in shown[module].split(", "), (
                f"{name} is no member on the page of {module}"
            )


def test_the_page_of_the_library_shows_only_names_of_mimic() -> None:
    page = (ROOT / "docs" / "reference" / "api" / "library.md").read_text(encoding="utf-8")
    members = re.findall(r"members: \[(.*)\]", page)
    assert len(members) == page.count("\n::: ")
    assert {name for names in members for name in names.split(", ")} <= set(mimic._MODULE_OF)


def test_the_table_of_commands_names_each_command() -> None:
    table = (ROOT / "docs" / "reference" / "commands.md").read_text(encoding="utf-8")
    missing = [name for name in app if not name.startswith("-") and f"`mimic {name}" not in table]
    assert missing == []


def test_the_navigation_of_the_site_has_every_page(site: ModuleType) -> None:
    configuration = yaml.safe_load((ROOT / "mkdocs.yml").read_text(encoding="utf-8"))
    written = {path.relative_to(ROOT / "docs").as_posix() for path in (ROOT / "docs").rglob("*.md")}
    written |= {f"results/{path.name}" for path in (ROOT / "lab" / "results").glob("*.md")}
    assert written | {"changelog.md"} == set(navigation(configuration["nav"]))


def test_a_page_that_the_site_leaves_out_is_no_silent_text(site: ModuleType, monkeypatch, caplog) -> None:
    card = "policies/go2_stand_track.md"
    site.site_links(f"[card](../../{card})", "manual/policy.md")
    assert caplog.text == ""
    monkeypatch.delitem(site.ADDED, card)
    site.site_links(f"[card](../../{card})", "manual/policy.md")
    assert "is no page of the site" in caplog.text


def test_links_that_leave_docs_become_pages_of_the_site_or_plain_paths(site: ModuleType) -> None:
    text = (
        "[log](../../CHANGELOG.md) [robot](robot.md#zeros) [law](../../mimic/dynamics/law.py) ![](../images/boxing.jpg)"
    )
    assert site.site_links(text, "manual/live.md") == (
        "[log](../changelog.md) [robot](robot.md#zeros) `law` ![](../images/boxing.jpg)"
    )
