"""Write the catalogue of effects into docs/calibration.md, between its two marks.

python docs/make_catalogue.py
"""

from __future__ import annotations

from pathlib import Path

from mimic.robot.effects import CATALOGUE, Effect

PAGE = Path(__file__).with_name("calibration.md")
BEGIN, END = "<!-- catalogue -->", "<!-- end of catalogue -->"


def catalogue_table() -> str:
    """Return the catalogue as a Markdown table."""
    lines = [
        "| effect | equation | parameters | of | what its residual looks like | motion that shows it | enters MuJoCo by | |",
        "|---|---|---|---|---|---|---|---|",
    ]
    lines += [_row(effect) for effect in CATALOGUE.values()]
    return "\n".join(lines)


def _row(effect: Effect) -> str:
    numbers = [f"`{p.name}`{'' if p.unit == '1' else f' [{p.unit}]'}" for p in effect.parameters]
    marks = [
        mark
        for mark, has in (
            ("declared", effect.declared),
            ("always refitted", effect.structural),
            ("read off target by target", effect.random),
            ("read off the readings", effect.read_off and not effect.random),
        )
        if has
    ]
    cells = (
        f"`{effect.name}`: {effect.title}",
        effect.equation,
        ", ".join(numbers),
        effect.scope,
        effect.signature,
        effect.experiment,
        effect.enters,
        ", ".join(marks),
    )
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"


def with_catalogue(page: str) -> str:
    """Return a page with the catalogue between its marks."""
    before, rest = page.split(BEGIN)
    _, after = rest.split(END)
    return f"{before}{BEGIN}\n{catalogue_table()}\n{END}{after}"


if __name__ == "__main__":
    PAGE.write_text(with_catalogue(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
