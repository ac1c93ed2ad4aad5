"""The commands and their options; each does its work in a module that is imported when it is called."""

from __future__ import annotations

import logging
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal

from cyclopts import App, Parameter
from cyclopts.exceptions import CycloptsError

from mimic import __version__
from mimic.errors import ConfigError, MimicError
from mimic.settings import (
    BusSettings,
    CalibrateSettings,
    EffectsSettings,
    EmulateSettings,
    EvaluateSettings,
    LanguageSettings,
    LearnSettings,
    LiveSettings,
    LogSettings,
    MdpSettings,
    PoseSettings,
    ProbeSettings,
    RetargetSettings,
    RobustnessSettings,
    RunSettings,
    SitDownEvaluateSettings,
    StandUpSettings,
    StoredSettings,
    TableSettings,
)

DONE, BUG, USER, STOPPED = 0, 1, 2, 3
"""Exit statuses."""

Flat = Parameter(name="*")

app = App(
    name="mimic",
    version=__version__,
    help="A person in a video moves, and a CyberDog 2 standing on its hind legs moves the same way.",
    default_parameter=Parameter(show_env_var=False),
    result_action="return_value",
    help_format="plaintext",  # markdown would take another 40 ms to load
    suppress_keyboard_interrupt=False,  # run() turns it into an exit status
)


@app.default
def play(
    source: Path | None = None,
    /,
    *,
    text: str | None = None,
    camera: str | None = None,
    sim: Annotated[bool, Parameter(negative="")] = False,
    robot: str | None = None,
    out: Annotated[Path | None, Parameter(name=["--out", "-o"])] = None,
    video: Path | None = None,
    view: bool | None = None,
    pose: Annotated[PoseSettings | None, Flat] = None,
    stored: Annotated[StoredSettings | None, Flat] = None,
    language: Annotated[LanguageSettings | None, Flat] = None,
    live: Annotated[LiveSettings | None, Flat] = None,
    retarget: Annotated[RetargetSettings | None, Flat] = None,
    run: Annotated[RunSettings | None, Flat] = None,
    model: Annotated[EffectsSettings | None, Flat] = None,
    bus: Annotated[BusSettings | None, Flat] = None,
) -> int:
    """Play a human video, stored motion or a sentence on the robot.

    Parameters
    ----------
    source
        A video of one person; motion of a person from elsewhere (.npz, .trc, .bvh); a motion in key frames (.yaml); or a
        track that mimic wrote (.parquet).
    text
        Instead, a sentence such as "step forward, then wave the left hand".
    camera
        Instead, follow a camera while it looks: its number or device, or a video that is played in its place.
    sim
        Play it in MuJoCo.
    robot
        Play it on the robot on these buses: can0, several with commas, slcan:/dev/ttyACM0, socketcand://HOST:PORT/can0.
        Without a source it stands until Ctrl-C.
    out
        Run folder; by default runs/NAME, with a number where that is taken.
    video
        Also film human and robot side by side into this MP4 file.
    view
        Open the Rerun viewer at the end; by default where a display exists.
    """
    if sim == (robot is not None):
        raise ConfigError(
            "say where to play it: add --sim for the simulated robot, or --robot can0 for the one on that bus"
            if robot is None
            else "--sim and --robot are two robots; give one of them"
        )
    given: Path | str | None = source if text is None else text
    if sum(way is not None for way in (source, text, camera)) > 1:
        raise ConfigError("a file, --text and --camera are ways in; give one of them")
    inputs = _inputs(pose, stored, retarget, language)
    if robot is not None:
        if video is not None:
            raise ConfigError("--video films the simulated robot; leave it out with --robot")
        from mimic.cli.robot import play_on_robot

        options = {"out": out, "view": view, "run": run or RunSettings(), "bus": bus or BusSettings()}
        return play_on_robot(given, robot, inputs, **options, camera=camera, live=live or LiveSettings())
    if camera is not None:
        if video is not None:
            raise ConfigError("--video films a run that is known before; leave it out with --camera")
        from mimic.cli.live import play_camera

        return play_camera(
            camera,
            inputs,
            live or LiveSettings(),
            out=out,
            view=view,
            run=run or RunSettings(),
            robot=model or EffectsSettings(),
        )
    if given is None:
        raise ConfigError("say what to play: a file, --text with a sentence, or --camera 0")
    from mimic.cli.play import play_source

    return play_source(
        given,
        inputs,
        out=out,
        film=video,
        view=view,
        run=run or RunSettings(),
        robot=model or EffectsSettings(),
    )


def _inputs(
    pose: PoseSettings | None,
    stored: StoredSettings | None,
    retarget: RetargetSettings | None,
    language: LanguageSettings | None = None,
) -> Any:
    """Return the settings of whatever is read; those not given are the defaults."""
    from mimic.cli.inputs import InputSettings

    given = {"pose": pose, "stored": stored, "retarget": retarget, "language": language}
    return InputSettings(**{name: value for name, value in given.items() if value is not None})


@app.command
def retarget(
    source: Path,
    /,
    *,
    out: Annotated[Path, Parameter(name=["--out", "-o"])],
    pose: Annotated[PoseSettings | None, Flat] = None,
    stored: Annotated[StoredSettings | None, Flat] = None,
    retarget: Annotated[RetargetSettings | None, Flat] = None,
) -> int:
    """Turn a video or stored motion into targets and stop there; ``mimic TARGETS --sim`` plays them later.

    Parameters
    ----------
    source
        A video of one person, or motion of a person from elsewhere (.npz, .trc, .bvh).
    out
        Parquet file to write.
    """
    from mimic.cli.play import retarget_only

    return retarget_only(source, out, _inputs(pose, stored, retarget))


@app.command
def batch(
    folder: Path,
    /,
    *,
    out: Annotated[Path, Parameter(name=["--out", "-o"])],
    workers: int = 0,
    ray: str | None = None,
    pose: Annotated[PoseSettings | None, Flat] = None,
    stored: Annotated[StoredSettings | None, Flat] = None,
    retarget: Annotated[RetargetSettings | None, Flat] = None,
    run: Annotated[RunSettings | None, Flat] = None,
    robot: Annotated[EffectsSettings | None, Flat] = None,
) -> int:
    """Play every video and motion file of a folder in simulation, into one table; goes on where it was stopped.

    Parameters
    ----------
    folder
        Looked through with all folders in it.
    out
        Folder for summary.html, summary.parquet and a folder for each file.
    workers
        Processes; 0 takes one for each core.
    ray
        Address of a Ray cluster that plays them instead, such as auto or 10.0.0.5:6379; its nodes need the same paths.
    """
    from mimic.cli.batch import batch as play_batch

    return play_batch(
        folder,
        out,
        _inputs(pose, stored, retarget),
        run=run or RunSettings(),
        robot=robot or EffectsSettings(),
        workers=workers,
        ray=ray,
    )


@app.command
def evaluate(
    policy: Path,
    /,
    *,
    table: Annotated[bool, Parameter(negative="")] = False,
    robustness: Annotated[bool, Parameter(negative="")] = False,
    stand_up: Annotated[bool, Parameter(negative="")] = False,
    out: Annotated[Path | None, Parameter(name=["--out", "-o"])] = None,
    episodes: int | None = None,
    seconds: float | None = None,
    seed: int = EvaluateSettings().seed,
    workers: int = 0,
    robot: Annotated[EffectsSettings | None, Flat] = None,
) -> int:
    """Judge a policy in plain MuJoCo from the lying start: standing up, reaching, walking, turning.

    A policy that sits down is judged by hand-overs from the shipped tracking policy.

    Parameters
    ----------
    policy
        ONNX file with its contract inside, such as policies/stand_track.onnx.
    table
        Instead, the columns of the paper's Table III, beside the paper's.
    robustness
        Instead, the share of survived episodes along each disturbance, with a heat map.
    stand_up
        Instead, standing up from 500 lying starts, and standing still for 20 s.
    out
        JSON file for all figures; by default evaluation-NAME.json, table-NAME.json, robustness-NAME.json or
        stand-up-NAME.json in the current folder. The heat map goes beside it.
    episodes
        Randomised episodes: 200; with --table 50 for each of three seeds; with --robustness 40 at each point; with
        --stand-up 500 starts; hand-overs to a policy that sits down: 500.
    seconds
        Length of a randomised episode: 20 s; with --robustness 10 s; of a start with --stand-up 3 s; latest hand-over:
        10 s.
    seed
        Seed of the first episode.
    workers
        Processes; 0 takes one for each core.
    """
    from mimic.cli import judge

    if table + robustness + stand_up > 1:
        raise ConfigError("--table, --robustness and --stand-up are ways of judging; give one of them")
    given = {"episodes": episodes, "seconds": seconds, "seed": seed, "workers": workers, "robot": robot}
    options: dict[str, Any] = {name: value for name, value in given.items() if value is not None}
    if table:
        return judge.evaluate_table(policy, out or Path(f"table-{policy.stem}.json"), TableSettings(**options))
    if robustness:
        settings = RobustnessSettings(**options)
        return judge.evaluate_robustness(policy, out or Path(f"robustness-{policy.stem}.json"), settings)
    if stand_up:
        return judge.evaluate_stand_up(policy, out or Path(f"stand-up-{policy.stem}.json"), StandUpSettings(**options))
    out = out or Path(f"evaluation-{policy.stem}.json")
    checked = EvaluateSettings(**options)
    if judge.task_of(policy) == "sit_down":
        return judge.evaluate_sit_down(policy, out, SitDownEvaluateSettings(**options))
    return judge.evaluate_policy(policy, out, checked)


@app.command
def train(
    out: Path,
    /,
    *,
    resume: Path | None = None,
    task: Literal["stand-track", "sit-down"] = "stand-track",
    worlds: int = MdpSettings().worlds,
    robot: Annotated[EffectsSettings | None, Flat] = None,
    learn: Annotated[LearnSettings | None, Flat] = None,
    set: Annotated[list[str] | None, Parameter(name="--set", negative="")] = None,
) -> int:
    """Train the low-level policy; on a GPU in minutes, on a CPU with few worlds to try it out.

    Parameters
    ----------
    out
        Folder for checkpoints, TensorBoard files and policy.onnx.
    resume
        Checkpoint (.pt) to go on from.
    task
        What is learnt: to stand up, walk and bring the front toes to goals, or to sit down.
    worlds
        Robots simulated at once.
    set
        name=value for any other setting, such as rewards.slip=-0.4 or randomisation.push=[0,0.5].
    """
    from mimic.cli.judge import train_policy

    robot = robot or EffectsSettings()
    around = {"effects": robot.effects, "timestep": robot.timestep} if robot.effects else {}
    mdp = replace(MdpSettings(), worlds=worlds, task=task.replace("-", "_"), **around)
    return train_policy(out, resume, mdp, learn or LearnSettings(), set or [])


@app.command
def calibrate(
    log: Path,
    /,
    *,
    model: Path | None = None,
    out: Annotated[Path | None, Parameter(name=["--out", "-o"])] = None,
    settings: Annotated[CalibrateSettings | None, Flat] = None,
) -> int:
    """Explain a log of a machine: what its model lacks, with evidence, and a model that has it.

    Parameters
    ----------
    log
        Parquet or CSV with a row a reading: t, q.JOINT and q_des.JOINT; see docs/log-format.md.
    model
        MJCF of the machine with its base held; by default the CyberDog 2 hung up.
    out
        Folder for report.html, calibration.json and effects.toml; by default calibration/NAME.
    """
    from mimic.cli.calibrate import calibrate_log

    return calibrate_log(log, model, out or Path("calibration") / log.stem, settings or CalibrateSettings())


log_app = App(name="log", help="Logs of machines.")
app.command(log_app)


@log_app.command
def simulate(
    *,
    out: Annotated[Path, Parameter(name=["--out", "-o"])],
    effects: Path | None = None,
    model: Path | None = None,
    motion: Literal["probe", "random"] = "probe",
    seconds: float = 120.0,
    size: float = 1.0,
    kp: float | None = None,
    kd: float | None = None,
    settings: Annotated[LogSettings | None, Flat] = None,
) -> int:
    """Log a simulated machine with hidden effects, as a real one would be logged.

    Parameters
    ----------
    out
        Parquet or CSV file to write.
    effects
        effects.toml with what the machine has; without, it is as its model says.
    model
        MJCF of the machine with its base held; by default the CyberDog 2 hung up.
    motion
        probe shows every effect; random is for a second log.
    seconds
        Length [s].
    size
        Share of the joints' ranges that the motion uses.
    kp
        Position gain of the drives [N m/rad]; by default the model's.
    kd
        Velocity gain of the drives [N m s/rad]; by default the model's.
    """
    from mimic.cli.calibrate import MotionOptions, simulate_to

    options = MotionOptions(kind=motion, seconds=seconds, size=size, kp=kp, kd=kd)
    return simulate_to(out, effects, model, options, settings or LogSettings())


@log_app.command
def replay(
    log: Path,
    /,
    *,
    effects: Annotated[tuple[Path, ...], Parameter(negative="")] = (),
    model: Path | None = None,
    whole: Annotated[bool, Parameter(negative="")] = False,
    threads: int = 0,
    out: Annotated[Path | None, Parameter(name=["--out", "-o"])] = None,
) -> int:
    """Tell how well models foretell a log, such as one that was not calibrated from; nothing is fitted.

    Parameters
    ----------
    log
        Parquet or CSV as for calibrate.
    effects
        effects.toml of a calibration; again for more, to compare them.
    model
        MJCF of the machine with its base held; by default the CyberDog 2 hung up.
    whole
        Replay it in one piece from its first reading. Without, pieces of 6 s begin with a measured position each.
    threads
        Threads; 0 takes one for each core.
    out
        JSON file for the errors.
    """
    from mimic.cli.calibrate import replay_log

    return replay_log(log, effects, model, whole, threads, out)


@app.command
def emulate(
    *,
    listen: str = "127.0.0.1:29536",
    slcan: int | None = None,
    buses: int = 1,
    wiring: Path | None = None,
    fault: Annotated[tuple[str, ...], Parameter(negative="")] = (),
    fault_seed: int | None = None,
    seconds: float | None = None,
    every: float = 10.0,
    view: Annotated[bool, Parameter(negative="")] = False,
    settings: Annotated[EmulateSettings | None, Flat] = None,
    robot: Annotated[EffectsSettings | None, Flat] = None,
) -> int:
    """Serve an emulated robot on emulated CAN buses, for rehearsals with ``--robot``.

    Parameters
    ----------
    listen
        Address for socketcand; port 0 takes a free one. Keep it on this computer: anybody who reaches it moves the robot.
    slcan
        Also serve slcan, the first bus on this port, the others on those after it; 0 takes free ones.
    buses
        How many buses the motors are on.
    wiring
        Copy of bus.toml; by default the one that ships with the robot.
    fault
        What goes wrong: KIND[:PLACE][=VALUE][@[+]FROM[-UNTIL]], such as motor_dead:FL_knee@12.5; again for more. Seconds of
        the emulation, or with + since the first motor was switched on. docs/robot.md lists the kinds.
    fault_seed
        Also draw one.
    seconds
        End after this; by default at Ctrl-C.
    every
        Tell bus load and lateness this often [s]; 0 not at all.
    view
        Watch it in MuJoCo's viewer.
    """
    from mimic.cli.emulate import ServeOptions
    from mimic.cli.emulate import emulate as serve

    options = ServeOptions(
        listen=listen,
        slcan=slcan,
        buses=buses,
        wiring=wiring,
        faults=fault,
        fault_seed=fault_seed,
        seconds=seconds,
        every=every,
        view=view,
    )
    return serve(options, settings or EmulateSettings(), robot or EffectsSettings())


@log_app.command
def salvage(run: Path, /) -> int:
    """Turn what a run on the robot had on disk when it was killed into its log.

    Parameters
    ----------
    run
        Folder of the run.
    """
    from mimic.cli.robot import salvage_run

    return salvage_run(run)


robot_app = App(name="robot", help="The robot on its CAN bus: find it, set its zeros, check it, measure its drives.")
app.command(robot_app)


@robot_app.command
def scan(buses: str, /, *, bus: Annotated[BusSettings | None, Flat] = None) -> int:
    """Find motors and IMU on the buses; nothing moves.

    Parameters
    ----------
    buses
        Such as can0; see mimic --help.
    """
    from mimic.cli.robot import scan_buses

    return scan_buses(buses, bus or BusSettings())


@robot_app.command
def zero(
    buses: str,
    /,
    *,
    again: Annotated[bool, Parameter(negative="")] = False,
    bus: Annotated[BusSettings | None, Flat] = None,
) -> int:
    """Set the zeros of a robot that lies on its folded legs; needed after every power-up. Nothing moves.

    Parameters
    ----------
    buses
        Such as can0; see mimic --help.
    again
        Forget what was known of this robot: the pose it lies in now is exactly the lying pose.
    """
    from mimic.cli.robot import zero_joints

    return zero_joints(buses, bus or BusSettings(), again=again)


@robot_app.command
def check(
    buses: str,
    /,
    *,
    hung: Annotated[bool, Parameter(negative="")] = False,
    bus: Annotated[BusSettings | None, Flat] = None,
) -> int:
    """Do the pre-flight alone; nothing moves.

    Parameters
    ----------
    buses
        Such as can0; see mimic --help.
    hung
        The robot hangs instead of lying.
    """
    from mimic.cli.robot import check_robot

    return check_robot(buses, bus or BusSettings(), hung=hung)


@robot_app.command
def probe(
    buses: str,
    /,
    *,
    out: Annotated[Path, Parameter(name=["--out", "-o"])] = Path("probe.parquet"),
    motion: Path | None = None,
    probe: Annotated[ProbeSettings | None, Flat] = None,
    bus: Annotated[BusSettings | None, Flat] = None,
) -> int:
    """Move the joints of a robot that hangs with its feet free, and log what ``mimic calibrate`` reads.

    Parameters
    ----------
    buses
        Such as can0; see mimic --help.
    out
        Parquet or CSV file to write.
    motion
        Play the targets of this run folder or log.parquet instead, drawn into the ranges in which nothing can touch.
    """
    from mimic.cli.robot import probe_robot

    return probe_robot(buses, out, motion, probe or ProbeSettings(), bus or BusSettings())


@app.command
def view(run: Path, /) -> int:
    """Open the Rerun scene of a run folder.

    Parameters
    ----------
    run
        Folder that ``mimic … --sim`` wrote, or its scene.rrd.
    """
    from mimic.cli.play import view_run

    return view_run(run)


def run(arguments: list[str]) -> int:
    """Parse the arguments, run the command and return the exit status."""
    logging.basicConfig(level=logging.WARNING, format="%(levelname)s %(message)s")
    from rich.console import Console

    errors = Console(stderr=True, highlight=False, soft_wrap=True)
    try:
        result = app(arguments, exit_on_error=False, print_error=False)
    except MimicError as error:
        errors.print(f"[bold red]mimic:[/] {_escaped(error)}")
        return USER
    except CycloptsError as error:
        cause = error.__cause__
        errors.print(f"[bold red]mimic:[/] {_escaped(cause if isinstance(cause, MimicError) else error)}")
        return USER
    except KeyboardInterrupt:
        errors.print("[bold red]mimic:[/] interrupted")
        return STOPPED
    return result if isinstance(result, int) else DONE


def _escaped(error: BaseException) -> str:
    from rich.markup import escape

    return escape(str(error).strip())
