"""``python -m mimic.train OUT [--resume CHECKPOINT] [name=value ...]``: training without the command-line library.

For a GPU machine that has little more than PyTorch, and for torchrun. ``name=value`` sets a field of MdpSettings,
LearnSettings, RewardWeights or Randomisation, such as ``worlds=4096 seed=2 rewards.slip=-0.4``.
"""

from __future__ import annotations

import argparse
import ast
import dataclasses
import logging
import sys
from pathlib import Path
from typing import Any, TypeVar

from mimic.errors import ConfigError, MimicError
from mimic.settings import LearnSettings, MdpSettings

S = TypeVar("S")


def changed(settings: S, path: str, value: Any) -> S:
    """Return the settings with the field at ``path`` (dots go down) replaced; lists become tuples."""
    name, _, rest = path.partition(".")
    inner = changed(getattr(settings, name), rest, value) if rest else value
    return dataclasses.replace(settings, **{name: inner})  # type: ignore[type-var]


def parse_overrides(words: list[str]) -> tuple[MdpSettings, LearnSettings]:
    """Return the default settings with ``name=value`` words applied.

    Raises:
        ConfigError: If a word has no such form or names no setting.
    """
    mdp, learn = MdpSettings(), LearnSettings()
    for word in words:
        name, equals, text = word.partition("=")
        if not equals:
            raise ConfigError(f"{word!r} is not a setting; expected name=value")
        try:
            value = ast.literal_eval(text)
        except (ValueError, SyntaxError):
            value = text
        first = name.split(".")[0]
        if first in {f.name for f in dataclasses.fields(mdp)}:
            mdp = changed(mdp, name, value)
        elif first in {f.name for f in dataclasses.fields(learn)}:
            learn = changed(learn, name, value)
        else:
            names = [f.name for s in (mdp, learn) for f in dataclasses.fields(s)]
            raise ConfigError(f"there is no setting {name!r}; there are {', '.join(names)}")
    return mdp, learn


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m mimic.train", description=__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("--resume", type=Path, default=None)
    parser.add_argument("--every", type=int, default=25, help="updates between two lines of figures")
    parser.add_argument("overrides", nargs="*")
    options = parser.parse_intermixed_args()
    logging.basicConfig(level=logging.INFO, format="%(message)s", stream=sys.stderr)

    def report(update: int, row: dict[str, float]) -> None:
        if update % options.every:
            return
        keys = ("elapsed_s", "reward", "episode", "std", "collect_s", "learn_s", "learning_rate")
        short = {k: row[k] for k in keys} | {k[6:]: v for k, v in row.items() if k.startswith("track/")}
        figures = " ".join(f"{k}={v:.3g}" for k, v in short.items())
        sys.stderr.write(f"{update} {row['steps'] / 1e6:.0f}M {figures}\n")
        sys.stderr.flush()

    from mimic.train.learn import train

    try:
        mdp, learn = parse_overrides(options.overrides)
        path = train(options.out, mdp, learn, resume=options.resume, report=report)
    except MimicError as error:
        sys.stderr.write(f"{error}\n")
        return 2
    sys.stderr.write(f"wrote {path}\n")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
