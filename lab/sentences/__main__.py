"""How many of 200 natural sentences a planner executes, refuses, or gets wrong.

    python -m lab.sentences                                                   # the phrasebook
    python -m lab.sentences --llm-url http://127.0.0.1:11434/v1 --llm-model NAME

Each motion is measured on its key frames (`checks`), whatever made it. "Wrong" is a motion that does something else
than the sentence says; a refusal is never wrong, but it is counted apart where the sentence can be executed.
"""

from __future__ import annotations

import argparse
import json
from collections import Counter
from pathlib import Path

from lab.sentences.checks import SENTENCES, does, sentences
from mimic.config.pose import LanguageSettings
from mimic.errors import SourceError
from mimic.robot.description import load_description
from mimic.robot.reach import Reach
from mimic.sources.text.planner import plan


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--llm-url", help="endpoint with OpenAI's chat completions API")
    parser.add_argument("--llm-model", help="name of the model there")
    parser.add_argument("--llm-timeout", type=float, default=120.0, help="timeout of an answer [s]")
    parser.add_argument("--llm-tokens", type=int, default=8000, help="longest answer that is asked for")
    parser.add_argument("--first", type=int, help="only the first sentences of each half")
    parser.add_argument("--show", choices=["seen", "all", "none"], default="none", help="print outcomes of sentences")
    parser.add_argument("--list", type=Path, default=SENTENCES, help="file of sentences, such as more.txt beside it")
    parser.add_argument("--out", type=Path, help="write every outcome as JSON")
    options = parser.parse_args()
    settings = LanguageSettings(
        llm_url=options.llm_url,
        llm_model=options.llm_model,
        llm_timeout=options.llm_timeout,
        llm_tokens=options.llm_tokens,
    )
    reach = Reach(load_description("cyberdog2"))
    counts: dict[str, Counter[str]] = {"seen": Counter(), "held out": Counter()}
    rows = []
    for sentence in sentences(options.list):
        half = "held out" if sentence.held_out else "seen"
        if options.first is not None and sum(row["half"] == half for row in rows) >= options.first:
            continue
        message = ""
        try:
            motion = plan(sentence.text, reach, settings)
            outcome = "executed" if does(motion, sentence, reach) else "wrong"
            message = "; ".join(dict.fromkeys(frame.what for frame in motion.frames))
        except SourceError as error:
            outcome, message = "refused", str(error)
        counts[half][outcome] += 1
        counts[half]["can be executed"] += sentence.readings != ("no",)
        counts[half]["refused, could be executed"] += outcome == "refused" and sentence.readings != ("no",)
        rows.append({"sentence": sentence.text, "half": half, "outcome": outcome, "message": message})
        if options.show == "all" or (options.show == "seen" and half == "seen"):
            print(f"{outcome:9s} {sentence.text}  [{'|'.join(sentence.readings)}]  {message[:110]}", flush=True)
    for half, own in counts.items():
        total = own["executed"] + own["refused"] + own["wrong"]
        share = own["executed"] / max(total, 1)
        print(
            f"{half}: {total} sentences, executed {own['executed']} ({share:.0%}), wrong {own['wrong']}, refused "
            f"{own['refused']} (of which {own['refused, could be executed']} could be executed)"
        )
    if options.out is not None:
        options.out.write_text(json.dumps(rows, indent=1, ensure_ascii=False))


if __name__ == "__main__":
    main()
