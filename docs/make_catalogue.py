"""Write the catalogue of effects into docs/reference/effects.md, between its two marks.

python docs/make_catalogue.py
"""

from __future__ import annotations

from pathlib import Path

from mimic.dynamics.catalogue import CATALOGUE, Effect

PAGE = Path(__file__).parent / "reference" / "effects.md"
BEGIN, END = "<!-- catalogue -->", "<!-- end of catalogue -->"


def catalogue_text() -> str:
    """Return the catalogue as Markdown: a table of all effects, then a section for each."""
    lines = ["| effect | what | parameters | scope |", "|---|---|---|---|"]
    lines += [_row(effect) for effect in CATALOGUE.values()]
    return "\n".join([*lines, "", *(_section(effect) for effect in CATALOGUE.values())]).rstrip()


def _row(effect: Effect) -> str:
    name = f"[`{effect.name}`](#{effect.name})"
    return f"| {name} | {effect.title} | {_parameters(effect)} | {effect.scope} |"


def _parameters(effect: Effect) -> str:
    return ", ".join(f"`{p.name}`{'' if p.unit == '1' else f' [{p.unit}]'}" for p in effect.parameters)


def _section(effect: Effect) -> str:
    """Return what there is to know about one effect."""
    marks = {
        "Baseline: fitted before anything else is looked for.": effect.baseline,
        "Always refitted: a derivative at its neutral value is blind to it.": effect.structural,
        "Read from the log, one command at a time.": effect.random,
        "Read from the positions.": effect.read_off and not effect.random,
    }
    items = {
        "Equation": f"`{effect.equation}`",
        "Residual": effect.signature,
        "Best excitation": effect.experiment,
        "In MuJoCo": effect.enters,
        "Source": effect.source,
        "Fit": " ".join(text for text, applies in marks.items() if applies),
    }
    return "\n".join(
        [f"### {effect.name}", "", *(f"* {key}: {text.rstrip('.')}." for key, text in items.items() if text), ""]
    )


def with_catalogue(page: str) -> str:
    """Return a page with the catalogue between its marks."""
    before, rest = page.split(BEGIN)
    _, after = rest.split(END)
    return f"{before}{BEGIN}\n{catalogue_text()}\n{END}{after}"


if __name__ == "__main__":
    PAGE.write_text(with_catalogue(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
