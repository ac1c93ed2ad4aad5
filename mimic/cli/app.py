"""The table of commands, and what happens around every command: options from a file, errors, exit status."""

from __future__ import annotations

import logging
import os
import shlex
import sys
from collections.abc import Mapping
from difflib import get_close_matches
from functools import partial
from pathlib import Path
from typing import Any

from cyclopts import (
    App,
    CoercionError,
    CycloptsError,
    MissingArgumentError,
    Parameter,
    UnknownOptionError,
    UnusedCliTokensError,
)

from mimic.cli.terminal.exit_status import DONE, STOPPED, USER_ERROR
from mimic.errors import ConfigError, MimicError
from mimic.version import __version__

EXAMPLES = """Examples:
  mimic video.mp4 --rate 0.1 --sim         play a video on the simulated robot
  mimic video.mp4 --sim --video film.mp4   also film person and robot
  mimic --text "wave the left hand" --sim  play a sentence
  mimic --robot can0                       real robot: stand until Ctrl-C
  mimic --robot cyberdog2                  the same on a stock CyberDog 2
  mimic --robot go2 --interface eth0       the same on a Unitree Go2 EDU

To see the options of a command: mimic COMMAND --help
All other settings: --config FILE.toml. To see them all: mimic config

Exit status: 0 done, 1 bug, 2 user error, 3 stopped by Ctrl-C or for safety,
4 some files of a batch failed."""

MUJOCO_GL = {"", "egl", "osmesa", "glfw"}
MUJOCO_GL |= {"disable", "disabled", "off", "false", "0", "enable", "enabled", "on", "true", "1"}
"""Values of the environment variable MUJOCO_GL that MuJoCo understands."""


def _as_typed(default: Any) -> str | None:
    """Return a default as it would be typed, numbers with at most four digits; None where the help shows none."""
    if default is None or default is False or default == ():
        return None
    if isinstance(default, tuple):
        return " ".join(map(str, default))
    return f"{default:.4g}" if isinstance(default, float) else "yes" if default is True else str(default)


DEFAULTS = Parameter(
    negative_iterable=(), negative_none=(), consume_multiple=True, show_env_var=False, show_default=_as_typed
)


class _Flowing:
    """The parser's help, with the lines of a docstring joined: a terminal breaks them elsewhere."""

    def __call__(self, console: Any, options: Any, panel: Any) -> None:
        from cyclopts.help import DefaultFormatter
        from rich.text import Text

        for entry in panel.entries:
            text = getattr(entry.description, "primary_renderable", None)
            if isinstance(text, Text):
                text.plain = " ".join(text.plain.split())
        DefaultFormatter()(console, options, panel)

    def __getattr__(self, name: str) -> Any:
        from cyclopts.help import DefaultFormatter

        return getattr(DefaultFormatter(), name)


app = App(
    name="mimic",
    version=__version__,
    help="Play human motion on a CyberDog 2 or a Go2 standing on its hind legs: in simulation or on a real robot.",
    help_epilogue=EXAMPLES,
    usage="Usage: mimic SOURCE --sim [OPTIONS]\n       mimic COMMAND [OPTIONS]",
    default_parameter=DEFAULTS,
    result_action="return_value",
    help_format="plaintext",  # markdown would take another 40 ms to load
    help_formatter=_Flowing(),
    suppress_keyboard_interrupt=False,  # run() turns it into an exit status
)
app.register_install_completion_command(help="Install completion for your shell.")

COMMANDS = {
    "demo": (
        "mimic.cli.play:demo",
        "Play a shipped clip in simulation.",
        "mimic demo",
        "mimic demo --video film.mp4",
        "mimic demo --mirror --rate 0.2",
    ),
    "retarget": (
        "mimic.cli.play:retarget",
        "Turn a video or recorded motion into toe targets.",
        "mimic retarget video.mp4 -o targets.parquet",
        "mimic retarget motion.npz -o targets.parquet --names left_wrist=LWRA",
        "mimic targets.parquet --sim",
    ),
    "batch": (
        "mimic.cli.batch:batch",
        "Play all files of a folder in simulation, into one table.",
        "mimic batch videos/ -o out",
        "mimic batch videos/ -o out --workers 8",
        "mimic batch videos/ -o out --ray auto",
    ),
    "export": (
        "mimic.cli.export:export",
        "Write a run as a LeRobot dataset, CSV, NPZ or MCAP; or a policy for rl_sar.",
        "mimic export runs/video -o dataset",
        "mimic export runs/video --format csv -o run.csv",
        "mimic export runs/video --format mcap -o run.mcap",
        "mimic export out -o dataset --no-video",
        "mimic export stand_track --robot-model go2 --format rl_sar -o policy/go2/mimic",
    ),
    "view": (
        "mimic.cli.play:view",
        "Open the Rerun scene of a run.",
        "mimic view runs/video",
        "mimic view runs/video --web",
    ),
    "lead": (
        "mimic.cli.lead:lead",
        "Lead a simulated robot by the hand.",
        "mimic lead --direction 30 --video lead.mp4",
        "mimic lead --toe right --most 6 --speed 0.15",
    ),
    "evaluate": (
        "mimic.cli.evaluate:evaluate",
        "Evaluate a policy over many episodes.",
        "mimic evaluate",
        "mimic evaluate sit_down",
        "mimic evaluate out/policy.onnx",
    ),
    "train": (
        "mimic.cli.train:train",
        "Train a low-level policy.",
        "mimic train out/",
        "mimic train out/ --set worlds=16 iterations=2 device=cpu",
        "mimic train out/ --recipe own.toml --set minutes=9",
    ),
    "calibrate": (
        "mimic.cli.calibrate:calibrate",
        "Find the effects that a model lacks, from logs of the machine.",
        "mimic calibrate log.parquet",
        "mimic calibrate log.csv --model arm.xml -o out",
        "mimic calibrate a.parquet b.csv --note b.csv:kp=10 --held-out c.parquet",
        "mimic calibrate log.parquet --effects stribeck backlash",
    ),
    "emulate": (
        "mimic.cli.emulate:emulate",
        "Serve an emulated robot, to rehearse --robot.",
        "mimic emulate",
        "mimic emulate --slcan --buses 2",
        "mimic emulate --fault motor_dead:FL_knee@12.5",
        "mimic emulate --board cyberdog2",
        "mimic emulate --board go2",
    ),
    "doctor": (
        "mimic.cli.doctor:doctor",
        "Check this computer's installation, and say how to fix what is missing.",
        "mimic doctor",
    ),
    "config": (
        "mimic.cli.settings_file:config",
        "Print all settings with their defaults, as a file for --config.",
        "mimic config > mimic.toml",
        "mimic video.mp4 --sim --config mimic.toml",
    ),
}
"""Name -> where the command is, what it does, and examples."""

GROUPS = {
    "log": (
        "Logs of machines: simulate, replay, salvage.",
        {
            "simulate": (
                "mimic.cli.log:simulate",
                "Write the log of a simulated machine with hidden effects.",
                "mimic log simulate --effects hidden.toml -o log.parquet",
                "mimic log simulate --model arm.xml --seconds 20 -o log.csv",
                "mimic log simulate --motion random --seed 5 -o second.parquet",
            ),
            "replay": (
                "mimic.cli.log:replay",
                "Predict a log with calibrated models; nothing is fitted.",
                "mimic log replay second.parquet --effects effects.toml",
                "mimic log replay second.parquet --effects a.toml b.toml",
            ),
            "salvage": (
                "mimic.cli.log:salvage",
                "Recover the log of a robot run that was killed.",
                "mimic log salvage runs/robot",
            ),
        },
    ),
    "robot": (
        "A real robot: scan, wire, zero, check, watch, damp, probe; or another one: new.",
        {
            "new": (
                "mimic.cli.robot:new",
                "Write the folder of another robot from its MJCF.",
                "mimic robot new go1.xml -o robots/go1",
            ),
            "scan": (
                "mimic.cli.robot:scan",
                "Find motors and IMU on the buses; nothing moves.",
                "mimic robot scan can0",
            ),
            "zero": ("mimic.cli.robot:zero", "Set the zeros after a power-up; nothing moves.", "mimic robot zero can0"),
            "check": (
                "mimic.cli.robot:check",
                "Run the pre-flight check alone; nothing moves.",
                "mimic robot check can0,can1",
                "mimic robot check cyberdog2 --interface eth0",
            ),
            "watch": (
                "mimic.cli.robot:watch",
                "Show live readings while you move the robot by hand.",
                "mimic robot watch can0",
                "mimic robot watch cyberdog2 --interface eth0",
            ),
            "wire": (
                "mimic.cli.robot:wire",
                "Write the wiring file while you move each joint by hand.",
                "mimic robot wire can0 -o wiring.toml",
            ),
            "damp": (
                "mimic.cli.robot:damp",
                "Damp motors that a program left on, and switch them off.",
                "mimic robot damp can0",
                "mimic robot damp go2 --interface eth0",
            ),
            "probe": (
                "mimic.cli.robot:probe",
                "Move a suspended robot and log it for calibrate.",
                "mimic robot probe can0 -o log.parquet",
            ),
        },
    ),
}
"""Name -> what its commands are for, and these commands."""


def _add(parent: App, commands: Mapping[str, tuple[str, ...]]) -> None:
    for name, (target, purpose, *examples) in commands.items():
        lines = "\n".join(f"  {line}" for line in examples)
        parent.command(target, name=name, help=purpose, help_epilogue=f"Examples:\n{lines}", usage=None)


_add(app, COMMANDS)
for _name, (_purpose, _commands) in GROUPS.items():
    _group = App(
        name=_name, help=_purpose, help_epilogue="", default_parameter=DEFAULTS, help_format="plaintext", usage=None
    )
    _add(_group, _commands)
    app.command(_group)


def run(arguments: list[str]) -> int:
    """Parse the arguments, run the command and return the exit status."""
    logging.basicConfig(level=logging.WARNING, format="%(levelname)s %(message)s")
    try:
        arguments = _with_config(arguments)
        _check_environment()
        _check_command(arguments)
        if not app.default_command:
            from mimic.cli.play import play

            app.default(play)
        result = app(arguments, exit_on_error=False, print_error=False)
    except MimicError as error:
        return _failed(error)
    except CycloptsError as error:
        return _failed(error.__cause__ if isinstance(error.__cause__, MimicError) else _explained(error))
    except EOFError:
        return _failed("a question could not be answered: there is no input; run it in a terminal, or add --yes")
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return DONE
    except ImportError as error:
        if "shared object file" not in str(error):
            raise
        from mimic.flows.doctor import LIBRARIES

        return _failed(f"the system lacks a library ({error}); {LIBRARIES}")
    except OSError as error:
        if error.filename is None and error.errno is None:
            raise
        where = f"{error.filename}: " if error.filename else ""
        return _failed(f"{where}{error.strerror}; free some space, change the rights or name another place")
    except KeyboardInterrupt as reason:
        _failed("; ".join(["interrupted", *map(str, reason.args)]))
        return STOPPED
    return result if isinstance(result, int) else DONE


def _explained(error: CycloptsError) -> object:
    """Return an error of the parser in mimic's words; for an option that is a setting, how to set it."""
    if isinstance(error, UnusedCliTokensError):
        return f"{shlex.join(error.unused_tokens or ())} is one argument too many; see --help"
    if isinstance(error, UnknownOptionError):
        from mimic.cli.settings_file import where_to_set

        option = error.token.keyword or error.token.value
        close = get_close_matches(option, ["--help", "--version"], n=1, cutoff=0.8)
        return f"Unknown option: {option}. Did you mean {close[0]}?" if close else where_to_set(error) or error
    if isinstance(error, MissingArgumentError) and error.argument and error.app:
        examples = [line.strip().partition("  ")[0] for line in str(error.app.help_epilogue).splitlines()[1:]]
        fitting = [example for example in examples if f"{error.argument.name} " in example]
        lacking = f"{error.keyword} needs a value" if error.keyword else f"{error.argument.name} is missing"
        return f"{lacking}; for example: {(fitting or examples)[0]}"
    if isinstance(error, CoercionError) and error.token:
        from mimic.config.values import expected

        return f"{error.token.keyword} is {error.token.value}; expected {expected(error.target_type)}"
    return error


def _failed(error: object) -> int:
    from rich.console import Console
    from rich.markup import escape

    console = Console(stderr=True, highlight=False, soft_wrap=True)
    console.print(f"[bold red]mimic:[/] {escape(str(error).strip())}")
    return USER_ERROR


def _with_config(arguments: list[str]) -> list[str]:
    """Return the arguments without --config FILE, whose settings count from now on."""
    app.config = ()
    for index, word in enumerate(arguments):
        name, equals, value = word.partition("=")
        if name != "--config":
            continue
        rest = arguments[index + 1 :]
        if not equals:
            if not rest:
                raise ConfigError("--config needs a file, such as --config mimic.toml")
            value = rest[0]
            rest = rest[1:]
        from mimic.cli.settings_file import apply_settings, read_settings

        app.config = (partial(apply_settings, read_settings(Path(value))),)
        return [*arguments[:index], *rest]
    return arguments


def _check_environment() -> None:
    given = os.environ.get("MUJOCO_GL", "")
    if given.lower().strip() not in MUJOCO_GL:
        raise ConfigError(
            f"the environment variable MUJOCO_GL is {given!r}; set it to egl, osmesa or disable, or unset it"
        )


def _check_command(arguments: list[str]) -> None:
    """Raise if the first word is neither a command nor anything that could be a file."""
    if not arguments or arguments[0].startswith("-"):
        return
    word = arguments[0]
    names = [*COMMANDS, *GROUPS]
    if word in names or os.path.exists(word) or Path(word).suffix or os.sep in word:
        return
    close = get_close_matches(word, [*names, "--help", "--version"], n=1)
    hint = f"did you mean: mimic {close[0]}" if close else f"commands are {', '.join(names)}; a sentence follows --text"
    if " " in word:
        hint = f"to play a sentence: mimic --text {shlex.quote(word)} --sim"
    raise ConfigError(f"there is no command and no file {word!r}; {hint}")
