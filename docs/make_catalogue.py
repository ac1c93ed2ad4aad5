"""Write the catalogue of effects into docs/reference/effects.md, between its two marks.

python docs/make_catalogue.py
"""

from __future__ import annotations

from pathlib import Path

from mimic.dynamics.catalogue import CATALOGUE, Effect

PAGE = Path(__file__).parent / "reference" / "effects.md"
BEGIN, END = "<!-- catalogue -->", "<!-- end of catalogue -->"


def catalogue_text() -> str:
    """Return the catalogue as Markdown: a section for each effect."""
    return "\n".join(_section(effect) for effect in CATALOGUE.values()).rstrip()


def _head(effect: Effect) -> str:
    """Return title, parameters and scope of an effect."""
    title = effect.title[0].upper() + effect.title[1:]
    return f"{title}, per {effect.scope}: {_parameters(effect)}."


def _parameters(effect: Effect) -> str:
    return ", ".join(f"`{p.name}`{'' if p.unit == '1' else f' [{p.unit}]'}" for p in effect.parameters)


def _section(effect: Effect) -> str:
    """Return what there is to know about one effect."""
    marks = {
        "baseline": effect.baseline,
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
    return "\n".join(
        [f"### {effect.name}", "", _head(effect), "", *(f"* {key}: {text.rstrip('.')}." for key, text in items.items() if text), ""]
    )


def with_catalogue(page: str) -> str:
    """Return a page with the catalogue between its marks."""
    before, rest = page.split(BEGIN)
    _, after = rest.split(END)
    return f"{before}{BEGIN}\n{catalogue_text()}\n{END}{after}"


if __name__ == "__main__":
    PAGE.write_text(with_catalogue(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
