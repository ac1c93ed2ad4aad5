"""Fixtures for most tests: the robot, the policy contract, policies with fixed answers, and a robot in memory."""

from __future__ import annotations

import signal
import tomllib
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mimic.control.loop import RunResult, run_policy
from mimic.control.safety.supervisor import Supervisor
from mimic.control.tick import Safety
from mimic.policy.contract import METADATA_KEY, NETWORK, PolicyContract
from mimic.policy.runtime import load_policy
from mimic.records import CommandTrack, Health, JointCommand, RobotState, Tick
from mimic.robot.description import RobotDescription, load_description


def pytest_configure() -> None:
    """Let Ctrl-C be counted where the shell ignores it, as it does for a job behind ``&``."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.hookimpl(tryfirst=True)  # before -m selects
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark the tests of training and those that write ONNX files: they need the extra 'train'."""
    training = Path(__file__).parent / "train"
    for item in items:
        if item.path.is_relative_to(training) or "constant_onnx" in getattr(item, "fixturenames", ()):
            item.add_marker("train")


@pytest.fixture(scope="session")
def description() -> RobotDescription:
    return load_description("cyberdog2")


@pytest.fixture(scope="session")
def overload(description: RobotDescription) -> tuple[np.ndarray, np.ndarray]:
    """Torques that the maker allows for a while, and for how long [s]."""
    table = tomllib.loads((description.folder / "robot.toml").read_text(encoding="utf-8"))["motor"]["overload"]
    return np.array(table["torque"]), np.array(table["seconds"])


@pytest.fixture(scope="session")
def contract(description: RobotDescription) -> PolicyContract:
    """The contract of the shipped policy."""
    return load_policy(None, description).contract


@pytest.fixture(scope="session")
def short_clip(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small video of a second and a half in which a person waves."""
    import cv2

    path = tmp_path_factory.mktemp("clip") / "clip.mp4"
    capture = cv2.VideoCapture(str(Path(__file__).parents[1] / "examples" / "videos" / "waving.mp4"))
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), 30.0, (640, 360))
    for _ in range(45):
        seen, picture = capture.read()
        assert seen
        writer.write(cv2.resize(picture, (640, 360)))
    writer.release()
    return path


@pytest.fixture(scope="session")
def constant_onnx(contract: PolicyContract) -> Callable[..., Path]:
    """Return a function that writes an ONNX policy which ignores what it sees."""
    onnx = pytest.importorskip("onnx", reason="writing an ONNX file needs the extra 'train'")

    def write(
        path: Path, *, metadata: str | None = contract.to_json(), seen: int = contract.observation_size, width: int = 12
    ) -> Path:
        helper, real = onnx.helper, onnx.TensorProto.FLOAT
        weights = onnx.numpy_helper.from_array(np.zeros((seen, width), dtype=np.float32), "weights")
        graph = helper.make_graph(
            [helper.make_node("MatMul", ["observation", "weights"], ["action"])],
            "constant",
            [helper.make_tensor_value_info("observation", real, [1, seen])],
            [helper.make_tensor_value_info("action", real, [1, width])],
            [weights],
        )
        model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
        if metadata is not None:
            helper.set_model_props(model, {METADATA_KEY: metadata})
        onnx.save(model, str(path))
        return path

    return write


FORGIVING = replace(
    load_description("cyberdog2").safety,
    turn_mismatch=10.0,
    toes_apart=10.0,
    toes_apart_moving=10.0,
    front_above=-10.0,
    jump=100.0,
)
"""Limits for the robot in memory: its base pitches whatever its legs do, and its joints jump with their commands."""

FRESH = Health(
    age=np.full(12, 0.018),
    missed=np.zeros(12, dtype=int),
    faults=np.zeros(12, dtype=int),
    running=np.ones(12, dtype=bool),
    temperature=np.full(12, 30.0),
    imu_age=0.005,
    imu_unchanged=0.005,
    imu_count=0,
    imu_valid=True,
    compute=0.001,
    late=0.0,
    bus_errors=0,
)
"""Fresh readings without faults."""


@dataclass
class MemoryPlant:
    """Joints follow their commands at once; the base does what ``pitch`` answer. Base position is not measured."""

    description: RobotDescription
    pitch: Callable[[int], float] = lambda tick: min(np.pi / 2, 0.1 * tick)
    """Angle of base x above the ground after a number of ticks [rad]."""
    heading: float = 0.0
    limit: float = np.inf
    """Joint positions that go out are clipped to plus and minus this [rad]."""
    fail: Callable[[int], None] = lambda tick: None
    """Called at each step before anything is sent; may raise."""
    health: Callable[[int, Health], Health] = lambda tick, health: health
    """Changes the health that each step reports."""
    sent: list[JointCommand] = field(default_factory=list)
    closed: int = 0
    damped_after: int | None = None
    """Commands that were sent before it was to be damped."""

    def start(self) -> RobotState:
        self.sent.clear()
        return self._state(self.description.poses["lie"])

    def step(self, command: JointCommand) -> Tick:
        self.fail(len(self.sent))
        clipped = np.clip(command.q_des, -self.limit, self.limit)
        out = JointCommand(q_des=clipped, dq_des=command.dq_des, kp=command.kp, kd=command.kd, tau_ff=command.tau_ff)
        self.sent.append(out)
        tick = len(self.sent)
        return Tick(state=self._state(clipped), sent=out, health=self.health(tick, replace(FRESH, imu_count=tick)))

    def damp(self) -> bool:
        if self.damped_after is None:
            self.damped_after = len(self.sent)
        return True

    def close(self) -> None:
        self.closed += 1

    def _state(self, q: np.ndarray) -> RobotState:
        tick = len(self.sent)
        jitter = 1e-6 * np.sin(7.0 * tick)  # an IMU never repeats itself exactly
        turn = Rotation.from_euler("ZY", [self.heading, jitter - self.pitch(tick)])
        return RobotState(
            t=tick * self.description.dt,
            q=np.array(q),
            dq=np.zeros(12),
            tau=np.zeros(12),
            quat_WB=turn.as_quat(scalar_first=True),
            omega_B=np.zeros(3),
            p_WB=np.full(3, np.nan),
            v_WB=np.full(3, np.nan),
        )


@dataclass
class FixedPolicy:
    """Answers ``answer`` of the number of the call."""

    contract: PolicyContract
    answer: Callable[[int], np.ndarray] = lambda call: np.zeros(12)
    path: Path = Path("fixed.onnx")
    seen: list[np.ndarray] = field(default_factory=list)

    def act(self, observation: np.ndarray) -> np.ndarray:
        self.seen.append(observation)
        return self.answer(len(self.seen) - 1)


@pytest.fixture
def memory_plant(description) -> Callable[..., MemoryPlant]:
    return lambda **options: MemoryPlant(description, **options)


@pytest.fixture
def forgiving(description) -> Callable[..., Safety]:
    """Return a function that makes the supervision of a robot in memory, with the defaults of a simulated run."""

    def make(**options) -> Safety:
        sits = options.pop("sits", True)
        return Safety(
            supervisor=Supervisor(description, FORGIVING, sits=sits),
            **{"ramp": 0.0, "tested": False, "damp_at_end": False} | options,
        )

    return make


@pytest.fixture
def play(forgiving) -> Callable[..., RunResult]:
    """Return a function that plays a run on a robot in memory."""

    def run(*args, sit_down=None, **options) -> RunResult:
        options.setdefault("safety", forgiving(sits=sit_down is not None))
        return run_policy(*args, sit_down=sit_down, **options)

    return run


@pytest.fixture
def fixed_policy(contract) -> Callable[..., FixedPolicy]:
    """Return a function that makes a policy that moves all legs, the front legs too."""
    return lambda **options: FixedPolicy(replace(contract, arms=NETWORK), **options)


@pytest.fixture
def track(contract) -> Callable[..., CommandTrack]:
    """Return a function that makes commands of a number of ticks: toes that sway, a walk, a turn."""

    def make(ticks: int = 20, *, v: float = 0.2, turn: float = 0.3) -> CommandTrack:
        t = contract.dt * np.arange(ticks)
        toes = np.array(contract.neutral_toes).reshape(2, 3) + 0.05 * np.sin(4 * t + 1)[:, None, None]
        speed = np.tile([v, 0.0], (ticks, 1))
        return CommandTrack(t=t, v=speed, heading=np.full(ticks, turn), p_BE=toes)

    return make
