"""``python -m mimic.train OUT [--recipe NAME] [--resume CHECKPOINT] [name=value ...]``: training without the
command-line library.

For a GPU machine that has little more than PyTorch, and for several GPUs: ``torchrun --nproc-per-node 2 -m mimic.train
OUT worlds=8192`` gives each of two GPUs 8192 worlds of its own. ``name=value`` sets a field of MdpSettings,
LearnSettings, RewardWeights or Randomisation, such as ``worlds=4096 seed=2 rewards.slip=-0.4``.
"""

from __future__ import annotations

import argparse
import logging
import os
import sys
from pathlib import Path

from mimic.config.training import LearnSettings, MdpSettings
from mimic.errors import MimicError
from mimic.train.overrides import recipe, with_overrides


def main() -> int:
    """Run the training and return the exit status."""
    parser = argparse.ArgumentParser(prog="python -m mimic.train", description=__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("--resume", type=Path, default=None)
    parser.add_argument("--recipe", default=None, help="settings of a shipped policy (stand_track), or a TOML file")
    parser.add_argument("--every", type=int, default=25, help="updates between two lines of figures")
    parser.add_argument("overrides", nargs="*")
    options = parser.parse_intermixed_args()
    logging.basicConfig(level=logging.INFO, format="%(message)s", stream=sys.stderr)

    def report(update: int, row: dict[str, float]) -> None:
        if update % options.every:
            return
        keys = ("elapsed_s", "reward", "episode", "std", "collect_s", "learn_s", "learning_rate")
        short = {k: row[k] for k in keys} | short_names(row)
        figures = " ".join(f"{k}={v:.3g}" for k, v in short.items())
        sys.stderr.write(f"{update} {row['steps'] / 1e6:.0f}M {figures}\n")
        sys.stderr.flush()

    from mimic.train.learn import train
    from mimic.train.runner import short_names

    try:
        words = [*(recipe(options.recipe) if options.recipe else []), *options.overrides]
        mdp, learn = with_overrides(MdpSettings(), LearnSettings(), words)
        path = train(options.out, mdp, learn, resume=options.resume, report=report)
    except MimicError as error:
        sys.stderr.write(f"{error}\n")
        return 2
    if os.environ.get("RANK", "0") == "0":
        sys.stderr.write(f"wrote {path}\n")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
