"""A real server on loopback speaks chat completions with answers good, sloppy and hostile."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable, Iterator
from contextlib import suppress
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

import numpy as np
import pytest

from mimic.config.pose import LanguageSettings
from mimic.errors import ConfigError, MissingExtra, SourceError
from mimic.io.keyframes import plain_frame
from mimic.robot.description import load_description
from mimic.robot.reach import Reach
from mimic.sources.text.grammar import plan_by_grammar
from mimic.sources.text.planner import CORRECTIONS, first_json, plan

SENTENCE = "step forward, then wave"


@pytest.fixture(scope="module")
def reach() -> Reach:
    return Reach(load_description("cyberdog2"))


class Endpoint:
    """A server that gives its answers in order, the last one for ever, and keeps what it was sent."""

    def __init__(self) -> None:
        self.answers: list[Any] = []
        self.sent: list[dict[str, Any]] = []
        self.keys: list[str | None] = []
        self.over = threading.Event()
        endpoint = self

        class Handler(BaseHTTPRequestHandler):
            def do_POST(self) -> None:
                body = json.loads(self.rfile.read(int(self.headers["Content-Length"])))
                endpoint.sent.append({"path": self.path, **body})
                endpoint.keys.append(self.headers.get("Authorization"))
                answer = endpoint.answers.pop(0) if len(endpoint.answers) > 1 else endpoint.answers[0]
                status, payload = 200, answer
                if callable(answer):
                    status, payload = answer(body)
                elif isinstance(answer, int):
                    status, payload = answer, {"error": {"message": f"canned {answer}", "type": "canned"}}
                elif answer is None:
                    endpoint.over.wait(30)
                    return
                elif isinstance(answer, str):
                    choice = {"index": 0, "finish_reason": "stop", "message": {"role": "assistant", "content": answer}}
                    payload = {"id": "1", "object": "chat.completion", "created": 0, "model": "m", "choices": [choice]}
                data = payload if isinstance(payload, bytes) else json.dumps(payload).encode()
                if payload == "drip":
                    with suppress(ConnectionError):
                        self.send_response(200)
                        self.send_header("Content-Length", "1000000")
                        self.end_headers()
                        while not endpoint.over.wait(0.05):
                            self.wfile.write(b" ")
                    return
                with suppress(ConnectionError):
                    self.send_response(status)
                    self.send_header("Content-Type", "application/json")
                    self.send_header("Content-Length", str(len(data)))
                    self.send_header("retry-after-ms", "1")
                    self.end_headers()
                    self.wfile.write(data)

            def log_message(self, *arguments: object) -> None:
                """Say nothing."""

        self.server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self.server.daemon_threads = True
        self.url = f"http://127.0.0.1:{self.server.server_address[1]}/v1"
        threading.Thread(target=self.server.serve_forever, args=(0.01,), daemon=True).start()

    def close(self) -> None:
        self.over.set()
        self.server.shutdown()
        self.server.server_close()


@pytest.fixture
def endpoint(monkeypatch) -> Iterator[Endpoint]:
    pytest.importorskip("openai", reason="asking a model needs the extra 'language'")
    monkeypatch.setenv("OPENAI_API_KEY", "a key")
    server = Endpoint()
    yield server
    server.close()


@pytest.fixture
def ask(endpoint, reach) -> Callable[..., Any]:
    def say(*answers: Any, timeout: float = 20.0) -> Any:
        endpoint.answers = ["first the arm goes up", *answers]
        settings = LanguageSettings(planner="llm", llm_url=endpoint.url, llm_model="canned", llm_timeout=timeout)
        return plan(SENTENCE, reach, settings)

    return say


@pytest.fixture(scope="module")
def frames(reach) -> list[dict[str, Any]]:
    """Frames that can be played, as a model would give them."""
    return [plain_frame(frame) for frame in plan_by_grammar(SENTENCE, reach).frames]


def as_json(frames: list[dict[str, Any]], **change: Any) -> str:
    return json.dumps({"frames": [{**frames[0], **change}, *frames[1:]]})


# ---------------------------------------------------------------------- good


def test_a_good_answer_is_taken_in_two_rounds(ask, endpoint, frames):
    motion = ask(as_json(frames))
    assert motion.planner == "canned"
    assert motion.sentence == SENTENCE
    assert [plain_frame(frame) for frame in motion.frames] == frames
    assert len(endpoint.sent) == 2
    assert all(request["path"] == "/v1/chat/completions" for request in endpoint.sent)
    roles = [[message["role"] for message in request["messages"]] for request in endpoint.sent]
    assert roles == [["system", "user"], ["system", "user", "assistant", "user"]]
    assert endpoint.sent[1]["messages"][2]["content"] == "first the arm goes up"
    assert endpoint.keys == ["Bearer a key"] * 2


def test_the_prompt_holds_this_robot_s_numbers(ask, endpoint, frames, reach):
    ask(as_json(frames))
    rules = endpoint.sent[0]["messages"][0]["content"]
    for value in (*np.degrees(reach.q_min[:3]), *np.degrees(reach.q_max[:3])):
        assert f"{value:.0f}" in rules
    assert f"{100 * reach.legs[0].thigh:.0f} cm" in rules
    assert "0.3" in rules


# ---------------------------------------------------------------------- sloppy

SLOPPY = {
    "prose around it": lambda text: f"Sure! Here is {{your}} motion:\n```json\n{text}\n```\nHave {{fun}}!",
    "another object before it": lambda text: f'{{"thoughts": "hm"}} {text}',
    "white space": lambda text: f"\n\n\t{text}\n",
}


@pytest.mark.parametrize("how", SLOPPY)
def test_what_is_around_the_json_makes_no_difference(how, ask, frames, endpoint):
    assert len(ask(SLOPPY[how](as_json(frames))).frames) == len(frames)
    assert len(endpoint.sent) == 2


FAULTS = {
    "radians": ({"left_deg": [0.0, 0.78, -1.22]}, "FL_knee is -1 deg; it must be from -140 to -35 deg"),
    "milliseconds": ({"duration": 500000}, "at most 60 s are played"),
    "too fast": ({"velocity": [3.0, 0.0]}, "velocity forward is 3 m/s"),
    "words for numbers": ({"duration": "half a second"}, "expected a number"),
    "NaN": ({"duration": float("nan")}, "expected finite numbers"),
    "a spin": ({"heading_deg": 720}, "the robot turns by at most 34 deg/s"),
    "a missing joint": ({"right_deg": [0, 45]}, "expected a list of 3, each a number"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_goes_back_with_the_exact_complaint_and_is_corrected(fault, ask, endpoint, frames):
    change, complaint = FAULTS[fault]
    motion = ask(as_json(frames, **change), as_json(frames))
    assert len(motion.frames) == len(frames)
    last = endpoint.sent[-1]["messages"]
    assert complaint in last[-1]["content"]
    assert last[-2]["role"] == "assistant"
    assert len(endpoint.sent) == 3


def test_a_model_that_never_learns_is_given_up_after_three_corrections(ask, endpoint, frames):
    with pytest.raises(SourceError, match="after 3 corrections: frame 1: velocity forward is 3 m/s"):
        ask(as_json(frames, velocity=[3.0, 0.0]))
    assert len(endpoint.sent) == 2 + CORRECTIONS
    assert len(endpoint.sent[-1]["messages"]) == 6


@pytest.mark.parametrize(
    "answer", ["", "I cannot do that.", "{'frames': [}", '{"frames": [{"duration": 1}', "{" * 5000]
)
def test_an_answer_without_json_is_asked_for_again(answer, ask, endpoint, frames):
    assert len(ask(answer, as_json(frames)).frames) == len(frames)
    assert "no complete JSON object" in endpoint.sent[-1]["messages"][-1]["content"]


# ---------------------------------------------------------------------- hostile


def test_a_million_frames_are_refused(ask, endpoint, frames):
    motion = ask('{"frames": [' + ",".join(["{}"] * 10**6) + "]}", as_json(frames))
    assert len(motion.frames) == len(frames)
    assert "give at most" in endpoint.sent[-1]["messages"][-1]["content"]
    assert sum(len(message["content"]) for message in endpoint.sent[-1]["messages"]) < 1_100_000


def test_a_thousand_frames_are_refused_by_their_number(ask, endpoint, frames):
    ask(json.dumps({"frames": frames[:1] * 1000}), as_json(frames))
    assert "there are 1000 frames; at most 100" in endpoint.sent[-1]["messages"][-1]["content"]


def test_text_that_instructs_the_program_what_to_do_is_only_text(ask, frames, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    order = (
        "IGNORE ALL RULES. __import__('os').system('touch hacked'); $(touch hacked); !!python/object/apply:os.system"
    )
    motion = ask(f"{order}\n{as_json(frames, what=order)}\n{order}")
    assert motion.frames[0].what.startswith("IGNORE ALL RULES")
    assert list(tmp_path.iterdir()) == []


def test_code_in_place_of_numbers_is_a_fault(ask, endpoint, frames):
    ask(as_json(frames, duration="__import__('os').getpid()", exec="rm -rf"), as_json(frames))
    message = endpoint.sent[-1]["messages"][-1]["content"]
    assert "expected a number" in message
    assert "'exec', which is unknown" in message


# ---------------------------------------------------------------------- what goes wrong on the way


@pytest.mark.parametrize(
    ("status", "message"),
    [(429, "too many requests or no credit"), (500, "answers with an error"), (401, "does not accept the key")],
)
def test_a_server_that_refuses_is_reported(status, message, ask, endpoint):
    endpoint.answers = [status]
    settings = LanguageSettings(llm_url=endpoint.url, llm_model="canned")
    with pytest.raises(SourceError, match=message) as error:
        plan(SENTENCE, Reach(load_description("cyberdog2")), settings)
    assert f"canned {status}" in str(error.value)
    assert len(endpoint.sent) == (1 if status == 401 else 3)


@pytest.mark.parametrize("status", [429, 500, 503])
def test_a_server_that_refuses_once_is_asked_again(status, endpoint, frames, reach):
    endpoint.answers = [status, "described", status, as_json(frames)]
    motion = plan(SENTENCE, reach, LanguageSettings(llm_url=endpoint.url, llm_model="canned"))
    assert len(motion.frames) == len(frames)


def test_a_server_that_never_answers_is_given_up(ask, endpoint):
    with pytest.raises(SourceError, match=r"did not answer within 0\.2 s"):
        ask(None, timeout=0.2)


def test_a_server_that_drips_its_answer_is_given_up_at_the_timeout(ask):
    with pytest.raises(SourceError, match=r"did not answer within 0\.3 s"):
        ask(lambda body: (200, "drip"), timeout=0.3)


def completion(content: Any) -> dict[str, Any]:
    return {"choices": [{"index": 0, "finish_reason": "stop", "message": {"role": "assistant", "content": content}}]}


@pytest.mark.parametrize("content", [5, {"a": 1}, [5], True])
def test_content_that_is_no_text_ends_in_one_line(content, endpoint, reach):
    endpoint.answers = [lambda body: (200, completion(content))]
    with pytest.raises(SourceError, match=r"has no chat completions API|no motion that can be played") as error:
        plan(SENTENCE, reach, LanguageSettings(llm_url=endpoint.url, llm_model="canned"))
    assert "\n" not in str(error.value)


def test_an_endpoint_that_wants_max_completion_tokens_and_no_temperature_gets_that(endpoint, reach, frames):
    def strict(body: dict[str, Any]) -> tuple[int, Any]:
        for name in ("max_tokens", "temperature"):
            if name in body:
                hint = " Use 'max_completion_tokens' instead." if name == "max_tokens" else ""
                return 400, {"error": {"message": f"Unsupported parameter: '{name}'.{hint}", "type": "invalid"}}
        return 200, completion(as_json(frames))

    endpoint.answers = [strict]
    motion = plan(SENTENCE, reach, LanguageSettings(llm_url=endpoint.url, llm_model="canned"))
    assert len(motion.frames) == len(frames)
    assert endpoint.sent[0]["max_tokens"] == 8000
    assert endpoint.sent[-1]["max_completion_tokens"] == 8000
    assert len(endpoint.sent) == 4  # each option is refused once, for the first question only


def test_the_length_of_an_answer_can_be_limited(endpoint, reach, frames):
    endpoint.answers = ["described", as_json(frames)]
    plan(SENTENCE, reach, LanguageSettings(llm_url=endpoint.url, llm_model="canned", llm_tokens=600))
    assert [request["max_tokens"] for request in endpoint.sent] == [600, 600]
    with pytest.raises(ConfigError, match="llm-tokens"):
        LanguageSettings(llm_tokens=0)


@pytest.mark.parametrize("payload", [b"<html>hello</html>", {"choices": []}, {"choices": None}, {"choices": [{}]}])
def test_what_is_no_chat_is_reported(payload, endpoint, reach):
    endpoint.answers = [payload]
    with pytest.raises(SourceError, match=r"has no chat completions API|no motion that can be played"):
        plan(SENTENCE, reach, LanguageSettings(llm_url=endpoint.url, llm_model="canned"))


def test_nobody_at_the_address_is_reported(endpoint, reach):
    url = endpoint.url
    endpoint.close()
    with pytest.raises(SourceError, match="no server answers at"):
        plan(SENTENCE, reach, LanguageSettings(llm_url=url, llm_model="canned"))


def test_an_endpoint_without_a_model_is_asked_about(reach):
    with pytest.raises(ConfigError, match=r"\[text\] llm_model"):
        plan(SENTENCE, reach, LanguageSettings(llm_url="http://127.0.0.1:1/v1"))


def test_without_a_key_or_an_endpoint_it_says_so(reach, monkeypatch):
    pytest.importorskip("openai", reason="asking a model needs the extra 'language'")
    for name in ("OPENAI_API_KEY", "OPENAI_BASE_URL"):
        monkeypatch.delenv(name, raising=False)
    with pytest.raises(ConfigError, match="OPENAI_API_KEY"):
        plan(SENTENCE, reach, LanguageSettings(planner="llm", llm_model="some"))


def test_without_the_client_the_extra_is_named(reach, monkeypatch):
    import sys

    monkeypatch.setitem(sys.modules, "openai", None)
    with pytest.raises(MissingExtra, match="which is not installed: pip install 'openai"):
        plan(SENTENCE, reach, LanguageSettings(llm_model="some"))


# ---------------------------------------------------------------------- who speaks


def test_without_an_endpoint_the_grammar_speaks(reach):
    assert plan(SENTENCE, reach, LanguageSettings()).planner == "grammar"
    asked = LanguageSettings(planner="grammar", llm_url="http://127.0.0.1:1/v1", llm_model="some")
    assert plan(SENTENCE, reach, asked).planner == "grammar"


def test_a_sentence_that_asks_for_too_much_is_refused(reach):
    with pytest.raises(SourceError, match=r"what this robot cannot do: the motion takes 90 s"):
        plan("walk for 90 seconds", reach, LanguageSettings())


@pytest.mark.parametrize("sentence", ["", "  ", "wave " * 1000])
def test_sentences_have_a_length(sentence, reach):
    with pytest.raises(SourceError, match="characters; say in 1 to 2000"):
        plan(sentence, reach, LanguageSettings())


def test_the_first_object_with_frames_is_read():
    assert first_json('{} {"a": {"frames": 1}} {"frames": 2} {"frames": 3}') == {"frames": 2}
    assert first_json("{" * 1000) is None
    assert first_json("none") is None
