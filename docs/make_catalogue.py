"""Write the table of effects into docs/reference/effects.md, between its two marks.

python docs/make_catalogue.py
"""

from __future__ import annotations

from pathlib import Path

from mimic.dynamics.catalogue import CATALOGUE, Effect

PAGE = Path(__file__).parent / "reference" / "effects.md"
BEGIN, END = "<!-- catalogue -->", "<!-- end of catalogue -->"


def catalogue_text() -> str:
    """Return the catalogue as a Markdown table."""
    lines = ["| effect | what | parameters | scope |", "|---|---|---|---|"]
    return "\n".join([*lines, *(_row(effect) for effect in CATALOGUE.values())])


def _row(effect: Effect) -> str:
    parameters = ", ".join(f"`{p.name}`{'' if p.unit == '1' else f' [{p.unit}]'}" for p in effect.parameters)
    return f"| `{effect.name}` | {effect.title} | {parameters} | {effect.scope} |"


def with_catalogue(page: str) -> str:
    """Return a page with the catalogue between its marks."""
    before, rest = page.split(BEGIN)
    _, after = rest.split(END)
    return f"{before}{BEGIN}\n{catalogue_text()}\n{END}{after}"


if __name__ == "__main__":
    PAGE.write_text(with_catalogue(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
