"""What the documentation shows: shell commands and Python snippets, and why some of them cannot be run here."""

from __future__ import annotations

import re
import textwrap
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
PAGES = [
    ROOT / "README.md",
    *sorted((ROOT / "docs").rglob("*.md")),
    *sorted((ROOT / "examples").rglob("*.md")),
    *sorted((ROOT / "policies").glob("*.md")),
    *sorted((ROOT / "lab").rglob("*.md")),
]

_BLOCK = re.compile(
    r"^```(?P<language>\w*)\n(?P<fenced>.*?)^```|(?P<indented>(?:^ {4}[^\n]*\n|^\n(?= {4}))+)", re.M | re.S
)
_COMMAND = re.compile(r"(?:uv run )?(?P<command>(?:mimic|python|python3|pip|uv|torchrun) .*)")

NOT_RUN = {
    r"^(python3 -m venv|pip install|uv )": "installs packages or runs the tests; .ci/run does that",
    r"^torchrun|^mimic train": "trains for minutes on a GPU",
    r"^python examples/": "tests/examples runs them",
    r"--policy my_policy": "needs a policy of the reader",
    r"^mimic motion\.csv": "a format whose reader the page adds",
    r"--robot-model": "a folder that the reader writes; tests/robot plays a second robot",
    r"--robot can0|--robot cyberdog2|--robot go2|^mimic robot ": "needs a robot",
    r"^mimic emulate|--robot socketcand": "two terminals; tests/flows/robot/test_robot_rehearsal.py rehearses it",
    r"^mimic (walk_poses\.npz|wham_output\.pkl|motion\.c3d)": "files of other programs; tests/sources/mocap makes such",
    r"--camera (0|clip)": "needs a camera, or a clip's time; tests/flows/motions/test_camera_to_run.py follows one",
    r'"step forward, then wave the left hand" --sim$|^mimic examples/videos/boxing.mp4': "tests/acceptance plays it",
    r"llm\.toml|^python -m llama_cpp": "needs a language model",
    r"mimic\.toml": "edits a file in between; tests/cli/test_settings_file.py reads and prints such files",
    r"^mimic lead": "renders a film, or needs a display; tests/flows/robot/test_lead.py runs a short one",
    r"^mimic evaluate": "takes minutes; tests/evaluation runs short ones",
    r"^mimic calibrate": "takes minutes; examples/calibrate_any_machine.py runs a short one",
    r"^mimic log simulate .*(-o (log|probe|second)\.parquet)": "takes a minute; tests/cli runs short ones",
    r"--sim --video": "renders a film for a minute; tests/flows renders a short one",
    r"^mimic log replay second.parquet --effects calibration": "takes a calibration; another replay runs",
    r"^mimic view": "opens a window",
    r"^mimic export": "needs the folder of a run; tests/flows/test_export.py makes one",
    r"^mimic demo": "tracks a whole clip; the first command of the README does the same",
    r"^python (-m lab\.|assets/)": "takes minutes, or writes into the repository",
    r"OPTION|FOLDER|\[|…": "a form, not a command",
}
"""Pattern of a command -> why it is only parsed."""

NOT_RUN_SNIPPETS = {
    r"path/to/folder": "needs a robot description of the reader",
}
"""Pattern of a Python snippet -> why it is not run."""


@dataclass(frozen=True)
class Shown:
    """A command or snippet, and the page that shows it."""

    text: str
    page: str

    def __str__(self) -> str:
        return f"{self.page}: {self.text.splitlines()[0]}"


def commands() -> list[Shown]:
    """Return every shell command of the pages, without its comment, each once."""
    found: dict[str, Shown] = {}
    for page, language, block in _blocks():
        if language in ("", "sh", "bash", "console"):
            for line in block.replace("\\\n", " ").splitlines():
                match = _COMMAND.match(line.removeprefix("$ "))
                if match:
                    text = re.sub(r"\s+# .*$", "", match["command"]).strip()
                    found.setdefault(text, Shown(text, page))
    return list(found.values())


def snippets() -> list[Shown]:
    """Return every Python snippet of the pages."""
    return [
        Shown(block, page)
        for page, language, block in _blocks()
        if language == "python" or (not language and re.search(r"^(import|from) \w+|^np\.", block, re.M))
    ]


def reason_not_to_run(text: str, reasons: dict[str, str]) -> str | None:
    """Return why a command or snippet is not run, or None."""
    return next((reason for pattern, reason in reasons.items() if re.search(pattern, text, re.M)), None)


def _blocks() -> list[tuple[str, str, str]]:
    """Return page, language and text of every block of code."""
    blocks = []
    for page in PAGES:
        for match in _BLOCK.finditer(page.read_text(encoding="utf-8")):
            text = match["fenced"] if match["fenced"] is not None else textwrap.dedent(match["indented"])
            blocks.append((page.relative_to(ROOT).as_posix(), match["language"] or "", text))
    return blocks
