"""A sentence -> key frames that this robot can do, by the grammar or by a language model whose answers are checked.

Nothing in an answer is executed. The first JSON object of the second answer is read and checked against the robot;
errors go back to the model, at most CORRECTIONS times.
"""

from __future__ import annotations

import json
import math
import os
import re
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import suppress
from itertools import islice
from typing import TYPE_CHECKING, Any

from mimic.config.pose import LanguageSettings
from mimic.errors import ConfigError, MissingExtra, SourceError
from mimic.io.keyframes import LARGEST, KeyFrame, KeyFrames, frames_from, one_line
from mimic.robot.reach import Reach
from mimic.sources.text import prompts
from mimic.sources.text.feasibility import violations
from mimic.sources.text.grammar import plan_by_grammar

if TYPE_CHECKING:
    from openai import OpenAI

CORRECTIONS = 3
"""How often a model may correct its answer."""
LONGEST_SENTENCE = 2000  # characters
REPORTED = 12  # at most this many errors go back at once
TRIES = 100  # places at which an answer may hold its object

Chat = Callable[[list[dict[str, str]]], str]


def uses_model(settings: LanguageSettings) -> bool:
    """Return whether a language model reads the sentence."""
    named = settings.llm_url is not None or settings.llm_model is not None
    return settings.planner == "llm" or (settings.planner == "auto" and named)


def plan(sentence: str, reach: Reach, settings: LanguageSettings) -> KeyFrames:
    """Return key frames for a sentence, all of which this robot can do; their ``planner`` says who spoke.

    Raises:
        SourceError: If the sentence is not understood, the endpoint does not answer, or its answers cannot be played.
        ConfigError: If no model is named.
        MissingExtra: If the client is not installed.
    """
    if not sentence.strip() or len(sentence) > LONGEST_SENTENCE:
        raise SourceError(
            f"the sentence has {len(sentence.strip())} characters; "
            f"say in 1 to {LONGEST_SENTENCE} what the robot should do"
        )
    if uses_model(settings):
        return _by_model(sentence, reach, settings)
    motion = plan_by_grammar(sentence, reach)
    check(motion, reach, settings, "the sentence asks for what this robot cannot do")
    return motion


def describe(motion: KeyFrames) -> Iterator[str]:
    """Yield a plan as it was understood: a line for each step, with the time [s] at which it begins.

    The phrasebook says in each key frame what it understood. What a language model writes there proves nothing, so that
    its key frames are described with their numbers: duration, distance and turn.
    """
    for word, meant in motion.typed:
        yield f"read         {word!r} as {meant!r}"
    t = 0.0
    heading = 0.0
    before = ""
    for frame in motion.frames:
        what = frame.what
        if motion.planner != "grammar":
            what = _numbers(frame, heading)
        if what != before or motion.planner != "grammar":
            yield f"{t:8.1f} s   {what}"
        t = t + frame.duration
        heading = frame.heading
        before = what
    yield f"{t:8.1f} s   end"


def _numbers(frame: KeyFrame, heading: float) -> str:
    """Return what a key frame does, in numbers."""
    turned = math.degrees(frame.heading - heading)
    ways = zip(("forward", "left"), (v * frame.duration for v in frame.velocity), strict=True)
    done = [f"{distance:+.2g} m {name}" for name, distance in ways if abs(distance) >= 0.01]
    done += [f"turn {'left' if turned > 0 else 'right'} {abs(turned):.0f}°"] if abs(turned) >= 1 else []
    return f"{frame.duration:.2g} s: {', '.join([frame.what, *done] if frame.what else done) or 'stand'}"


def check(motion: KeyFrames, reach: Reach, settings: LanguageSettings, prefix: str) -> None:
    """Check key frames against the limits of the robot.

    Raises:
        SourceError: If it cannot do them; the message begins with ``prefix``.
    """
    errors = violations(motion, reach, settings.longest)
    if errors:
        raise SourceError(f"{prefix}: {one_line(errors)}")


def _by_model(sentence: str, reach: Reach, settings: LanguageSettings) -> KeyFrames:
    model = settings.llm_model
    if model is None:
        raise ConfigError("name the model at the endpoint as [text] llm_model in --config, or leave planner to grammar")
    chat = _chat(settings, model)
    messages = [
        {"role": "system", "content": prompts.rules(reach, settings.longest)},
        {"role": "user", "content": prompts.describe(sentence)},
    ]
    messages.append({"role": "assistant", "content": chat(messages)[:LARGEST]})
    messages.append({"role": "user", "content": prompts.ask_targets(reach)})
    errors: list[str] = []
    for _ in range(1 + CORRECTIONS):
        answer = chat(messages)
        motion, errors = _read(answer, sentence, model)
        if motion is not None:
            errors = violations(motion, reach, settings.longest)
            if not errors:
                return motion
        more = [f"and {len(errors) - REPORTED} more like these"] if len(errors) > REPORTED else []
        messages = [
            *messages[:4],  # only the last answer and its faults, so that the messages does not grow
            {"role": "assistant", "content": answer[:LARGEST]},
            {"role": "user", "content": prompts.report_errors([*errors[:REPORTED], *more])},
        ]
    raise SourceError(
        f"{model} gave no motion that can be played, after {CORRECTIONS} corrections: {one_line(errors)}; "
        "say it more simply, try another model, or set [text] planner to grammar"
    )


def _read(answer: str, sentence: str, model: str) -> tuple[KeyFrames | None, list[str]]:
    """Return the motion in an answer, or what is wrong with it."""
    if len(answer) > LARGEST:
        return None, [f"the answer has {len(answer)} characters; give at most {LARGEST}"]
    data = first_json(answer)
    if data is None:
        return None, ["the answer holds no complete JSON object with 'frames'"]
    frames, errors = frames_from(data)
    return (None, errors) if errors else (KeyFrames(frames=frames, sentence=sentence, planner=model), [])


def first_json(text: str) -> Any:
    """Return the first JSON object with ``frames`` in a text, ignoring the prose around it; None if there is none."""
    decoder = json.JSONDecoder()
    value: dict[str, Any] = {}
    end = 0
    for brace in islice(re.finditer("{", text), TRIES):
        with suppress(ValueError, RecursionError):
            if brace.start() >= end:
                value, end = decoder.raw_decode(text, brace.start())
        if "frames" in value:
            return value
    return None


def _chat(settings: LanguageSettings, model: str) -> Chat:
    """Return a function that sends a messages and returns the answer."""
    try:
        import openai
    except ModuleNotFoundError as missing:
        raise MissingExtra(str(missing.name), "language") from None
    where = settings.llm_url or os.environ.get("OPENAI_BASE_URL") or "OpenAI"
    key = os.environ.get("OPENAI_API_KEY")
    if key is None and where == "OpenAI":
        raise ConfigError(
            "put your key into the environment as OPENAI_API_KEY, or name an endpoint as [text] llm_url in --config"
        )
    client: OpenAI = openai.OpenAI(
        base_url=settings.llm_url, api_key=key or "none", timeout=settings.llm_timeout, max_retries=2
    )
    options: dict[str, Any] = {"temperature": 0.2, "max_tokens": settings.llm_tokens}

    def ask(messages: Any) -> str:
        while True:
            try:
                answer = client.chat.completions.create(model=model, messages=messages, **options)
                return str(answer.choices[0].message.content or "")
            except openai.BadRequestError as error:
                if not _without_refused_option(options, str(error)):
                    raise

    late = f"{where} did not answer within {settings.llm_timeout:g} s; wait longer ([text] llm_timeout)"
    failures: list[tuple[Any, str]] = [
        ((openai.APITimeoutError, TimeoutError), f"{late}, or set [text] planner to grammar"),
        (openai.APIConnectionError, f"no server answers at {where} (%s); is the server running there?"),
        (openai.RateLimitError, f"{where} refuses for now, too many requests or no credit (429): %s"),
        (openai.AuthenticationError, f"{where} does not accept the key in OPENAI_API_KEY (401): %s"),
        (openai.APIStatusError, f"{where} answers with an error: %s"),
        (Exception, f"{where} has no chat completions API: %s; check [text] llm_url"),
    ]

    def chat(messages: list[dict[str, str]]) -> str:
        try:
            return _within(settings.llm_timeout, lambda: ask(messages))
        except Exception as error:  # an answer of another form fails in any way
            text = next(text for kind, text in failures if isinstance(error, kind))
            raise SourceError(text.replace("%s", " ".join(str(error).split())[:200])) from None

    return chat


def _without_refused_option(options: dict[str, Any], message: str) -> bool:
    """Drop or rename an option that an endpoint refuses; return whether there was one."""
    if "max_completion_tokens" in message and "max_tokens" in options:
        options["max_completion_tokens"] = options.pop("max_tokens")
    elif "temperature" in message and "temperature" in options:
        del options["temperature"]
    else:
        return False
    return True


def _within(seconds: float, work: Callable[[], str]) -> str:
    """Return what a function returns, or give up after a time; a server that drips bytes never lets it end.

    Raises:
        TimeoutError: If it takes longer.
    """
    outcome: Future[str] = Future()

    def run() -> None:
        try:
            outcome.set_result(work())
        except BaseException as error:
            outcome.set_exception(error)

    threading.Thread(target=run, daemon=True).start()
    return outcome.result(seconds)
