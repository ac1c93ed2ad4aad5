"""What an ONNX policy declares, and the one place where its observation is built, for training and for running.

An observation is the newest frames, oldest first, each of the contract's terms in their order: TERMS, or those of the
paper (PAPER_TERMS), which has neither gyro nor joint velocities. There is no base velocity. Source: Li et al. 2024,
section III, with the gait clock of its public code.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from mimic.config.text_file import from_json
from mimic.config.values import made
from mimic.errors import ContractError
from mimic.geometry import heading_sin_cos, world_axes_in_base
from mimic.records import JOINTS, FloatArray, IntArray
from mimic.robot.description import RobotDescription

FRONT = 6
"""Joints of the front legs: the first six."""

NETWORK = "network"
INVERSE_KINEMATICS = "inverse_kinematics"
"""Who moves the front legs."""

PAPER_TERMS = (
    ("joint_position", 12),
    ("down", 3),
    ("forward", 3),
    ("last_action", 12),
    ("velocity_command", 2),
    ("heading_error", 1),
    ("toe_command", 6),
    ("clock", 2),
)
"""Name and width of each term of one frame, in the order of the paper."""

AVERAGED = ("joint_position", "down", "forward", "velocity_command")
"""Terms that `slow_mean` averages."""

TERMS = (
    *(term for term in PAPER_TERMS if term[0] != "toe_command"),
    ("gyro", 3),
    ("joint_velocity", 12),
    ("slow_mean", sum(width for name, width in PAPER_TERMS if name in AVERAGED)),
)
"""The same of the policies that are trained now."""

AHEAD = (0.0, 0.1, 0.2, 0.3)
"""Times from now at which a policy is told where its arms will be [s]."""

ARM_TERMS = (("arm_reference", 12 * len(AHEAD)), ("arms_known", 1))
"""What comes once in an observation, after the frames, where inverse kinematics moves the front legs."""

SLOW_SECONDS = 3.0
"""Time constant of `slow_mean` [s]."""

GYRO_SCALE = 0.25
GYRO_CLIP = 5.0
DQ_SCALE = 0.05
"""Units a rad/s of `gyro` and `joint_velocity`."""
DQ_CLIP = 2.0
"""Largest value of them."""

FORMULAS = {
    "joint_position": "q - default_q [rad], joints in the order of `joints`",
    "down": "the world's (0, 0, -1) in base axes: (-2 (x z - w y), -2 (y z + w x), -(1 - 2 (x x + y y)))",
    "forward": "the world's (1, 0, 0) in base axes: (1 - 2 (y y + z z), 2 (x y - w z), 2 (x z + w y))",
    "last_action": "the action of the step before, after clipping; zeros at the first step",
    "velocity_command": "desired velocity forward and left in the heading frame [m/s], within velocity_max",
    "heading_error": "desired heading - heading [rad], wrapped to +-pi, then clipped to +-1; positive turns left",
    "toe_command": "desired base -> front toe [m], base axes (x forward, y left, z up): left x y z, right x y z",
    "clock": "gait sin(c) and gait cos(c), c = 2 pi clock_hz dt k; gait is 1 where clock_fade is 0",
    "gyro": f"{GYRO_SCALE} x angular velocity of the base, base axes [rad/s], clipped to +-{GYRO_CLIP:g}; bias removed",
    "joint_velocity": f"{DQ_SCALE} dq [rad/s], clipped to +-{DQ_CLIP:g}",
    "arm_reference": f"where the front legs will be in {', '.join(f'{t:g}' for t in AHEAD)} s: each time their "
    f"six joints, q - default_q [rad], then {DQ_SCALE} dq [rad/s]; zeros until the blend begins",
    "arms_known": "1 where that is known; 0 where the motion has no future: later positions are then those of now, "
    "later velocities 0",
    "slow_mean": f"{', '.join(AVERAGED)}, averaged: s = s + (now - s) dt / {SLOW_SECONDS:g} at each step; before the "
    "first step s = now",
}
"""What each term is. w, x, y, z is the orientation of the base in a world whose z is up."""

HOW_TO_PLAY = (
    "Every dt: read joints and orientation, make a frame, run the network, send q_des with the gains kp and kd.",
    "gait says whether to step: 0 before the first step; at every step, before the frame is made, it grows by "
    "dt / clock_fade, to 1 at most, if the speed of velocity_command is above walk_speed or |heading_error| above "
    "walk_turn (1 - gait / 2); otherwise it falls by as much, to 0 at least.",
    "A frame is the terms one after another. The observation is the newest `history` frames, oldest first, then the "
    "terms of `once` as they are now, 32-bit floats; at the first step every frame is the first one. k counts the "
    "steps from 0.",
    "action = clip(output, -action_clip, action_clip); q_des = clip(default_q + action_scale action, q_min, q_max).",
    "The heading is atan2(-2 (x y - w z), 1 - 2 (x x + z z)): where the belly faces once the robot stands.",
    "Each motor gives kp (q_des - q) - kd dq, at most torque_max; in the direction of motion the limit falls from "
    "there at speed_flat to none at speed_max.",
    "A q_des takes effect `delay` after the reading. With interpolate the motor's q_des then moves in a straight line, "
    "over dt, from the one before to it; without, it jumps there. It is held until the next one takes effect.",
)
"""How a policy of any task is played, in sentences."""

TASK_GUIDE = {
    "stand_track": (
        "It begins at rest on folded legs, knees under the hips. For the first stand_up_steps steps the toe command is "
        "neutral_toes, the velocity is zero and the desired heading is the heading at the first step.",
        "Then the toe command moves from where the toes are to the first target within blend_steps steps: with "
        "s = (i + 1) / blend_steps in step i from 0, by the share s s (3 - 2 s).",
        "Toe targets from toe_low to toe_high were trained, given for the left toe; the right toe mirrors y.",
        "With arms inverse_kinematics the front legs leave the network when that blend begins: their q_des is "
        "q + (kd dq + tau) / kp of the joints q that bring the toes to their targets, delay + dt ahead, with tau the "
        "torque of gravity, inertia and friction; while they blend, q moves with the same share from the measured "
        "joints. The network still sees its own action for them, or with arm_reference zeros.",
    ),
    "sit_down": (
        "It begins in whatever state a tracking policy has left, with a history and a clock of its own. The toe "
        "command is neutral_toes, the velocity is zero and the desired heading is the heading at the first step.",
    ),
}
"""How it begins and what it may be asked for, by task."""

FRAME_SIZE = sum(width for _, width in TERMS)
"""Width of a frame of the policies that are trained now."""


METADATA_KEY = "mimic_contract"
"""Key of the contract in the ONNX file's metadata."""

BY_JOINT = ("kp", "kd", "torque_max", "speed_flat", "speed_max")
"""Fields with a value for each joint; a file may have one for all."""


@dataclass(frozen=True, kw_only=True)
class PolicyContract:
    """Everything a policy needs to be run as it was trained."""

    robot: str
    """Name of the robot description."""
    joints: tuple[str, ...]
    """Order of joint quantities."""
    default_q: tuple[float, ...]
    """Joint positions of a zero action [rad]."""
    action_scale: tuple[float, ...]
    """Radians per unit of action."""
    action_clip: float
    """Actions are clipped to plus and minus this."""
    q_min: tuple[float, ...]
    """Commanded joint positions are clipped to these [rad]."""
    q_max: tuple[float, ...]
    """… and these [rad]."""
    kp: tuple[float, ...]
    """Position gain of each motor [N m/rad]."""
    kd: tuple[float, ...]
    """Velocity gain of each motor [N m s/rad]."""
    dt: float
    """Control step [s]."""
    history: int
    """Frames in an observation, oldest first."""
    terms: tuple[tuple[str, int], ...]
    """Name and width of each term of a frame."""
    clock_hz: float
    """Frequency of the gait clock [Hz]."""
    neutral_toes: tuple[float, ...]
    """Desired base -> front toe while standing up, left then right [m]."""
    stand_up_steps: int
    """Control steps from lying until toe commands count."""
    blend_steps: int
    """Control steps in which the toe command then moves to the first target."""
    velocity_max: tuple[float, ...]
    """Fastest velocity command, forward and left [m/s]."""
    toe_low: tuple[float, ...]
    """Lowest target of the left toe (3,), base axes [m]."""
    toe_high: tuple[float, ...]
    """Highest target of the left toe (3,), base axes [m]."""
    torque_max: tuple[float, ...]
    """Peak torque of each motor [N m]."""
    speed_flat: tuple[float, ...]
    """Joint speed up to which it gives it [rad/s]."""
    speed_max: tuple[float, ...]
    """Joint speed at which it gives no driving torque [rad/s]."""
    delay: float
    """From a command to its effect [s]."""
    task: str
    """What it was trained to do: stand_track or sit_down."""
    interpolate: bool
    """Whether commanded positions move linearly from one control step's to the next, instead of at once."""
    clock_fade: float
    """Time in which the gait clock fades in and out as the robot is asked to step and to stand [s]; 0 never fades."""
    walk_speed: float
    """Velocity command above which the robot is asked to step [m/s]."""
    walk_turn: float
    """Heading error above which it is asked to step [rad]; half as much once it steps."""
    arms: str = NETWORK
    """Who moves the front legs from the blend to the first target on: network or inverse_kinematics."""
    once: tuple[tuple[str, int], ...] = ()
    """Name and width of each term that comes once, after the frames."""
    training: str = ""
    """SHA-256 of the settings.json of its training."""
    noise: tuple[tuple[str, float], ...] = ()
    """Half width of the training noise on each term, in its units. Empty: not recorded."""

    @property
    def frame_size(self) -> int:
        """Width of a frame."""
        return sum(width for _, width in self.terms)

    @property
    def observation_size(self) -> int:
        """Width of the observation."""
        return self.history * self.frame_size + sum(width for _, width in self.once)

    def columns(self, *names: str) -> IntArray:
        """Return where terms stand in a frame, in the order of the names; none for a term that it lacks."""
        at = [name for name, width in self.terms for _ in range(width)]
        return np.array([i for name in names for i, other in enumerate(at) if other == name], dtype=np.int64)

    def to_json(self) -> str:
        """Return the contract as JSON, at full precision, with sentences on how to play the policy."""
        formulas = {name: FORMULAS[name] for name, _ in (*self.terms, *self.once)}
        guide = {"formulas": formulas, "how_to_play": HOW_TO_PLAY + TASK_GUIDE.get(self.task, ())}
        return json.dumps(asdict(self) | guide, sort_keys=True)

    @staticmethod
    def from_json(text: str) -> PolicyContract:
        """Read a contract.

        Raises:
            ContractError: If it is no JSON or a field is missing or unknown.
        """
        try:
            data = from_json(text)
            one_for_all = {name: [data[name]] * len(JOINTS) for name in BY_JOINT if isinstance(data.get(name), float)}
            own = {name: value for name, value in data.items() if name not in ("formulas", "how_to_play")}
            return made(PolicyContract, own | one_for_all)
        except (ValueError, TypeError, AttributeError) as reason:
            raise ContractError(f"the policy's contract cannot be read ({reason}); export the policy again") from None

    def check(self, description: RobotDescription) -> None:
        """Refuse a contract that does not fit the robot or this version's observation.

        Raises:
            ContractError: With what was given and what was expected.
        """
        if self.robot != description.name:
            raise ContractError(
                f"the policy was trained for {self.robot}; it cannot drive the robot {description.name} (--robot-model)"
            )
        pairs = (
            ("joint order", self.joints, JOINTS),
            ("observation terms", self.terms, PAPER_TERMS if self.terms == PAPER_TERMS else TERMS),
            ("terms after the frames", self.once, ARM_TERMS if self.once else ()),
            ("control step", self.dt, description.dt),
            ("number of action scales", len(self.action_scale), len(JOINTS)),
            ("number of default positions", len(self.default_q), len(JOINTS)),
            ("number of gains", (len(self.kp), len(self.kd)), (len(JOINTS), len(JOINTS))),
        )
        for what, given, expected in pairs:
            if given != expected:
                raise ContractError(f"the policy's {what} is {given}; this robot expects {expected}")
        if self.arms not in (NETWORK, INVERSE_KINEMATICS):
            raise ContractError(f"the policy's arms is {self.arms!r}; expected {NETWORK} or {INVERSE_KINEMATICS}")
        self._check_numbers(description)
        low = np.array(self.q_min)
        high = np.array(self.q_max)
        if np.any(low < description.q_min - 1e-9) or np.any(high > description.q_max + 1e-9):
            raise ContractError("the policy may command joint positions outside this robot's limits; expected inside")

    def _check_numbers(self, description: RobotDescription) -> None:
        """Refuse numbers that no trained policy has, before they reach a motor."""
        for name in ("default_q", "action_scale", "q_min", "q_max", "neutral_toes"):
            if not np.isfinite(getattr(self, name)).all():
                raise ContractError(f"the policy's {name} holds a number that is not finite; export the policy again")
        ranges = (
            ("kp", self.kp, MAX_KP_RATIO * description.kp, "N m/rad"),
            ("kd", self.kd, description.kd_max, "N m s/rad"),
            ("action_clip", self.action_clip, MAX_ACTION, "units"),
        )
        for name, values, most, unit in ranges:
            for value, limit in np.broadcast(values, most):
                if not 0.0 < value <= limit:  # NaN is refused too
                    raise ContractError(
                        f"the policy's {name} is {value:g} {unit}; expected more than 0, at most {limit:g}"
                    )


MAX_KP_RATIO = 5.0
"""A policy's position gain is at most this times the robot's own; the stiffest that was tried is five times."""

MAX_ACTION = 100.0
"""Actions are clipped at most to this; trained policies stay below 20."""


def lead_time(contract: PolicyContract) -> float:
    """Return the time from sending a command to when the joints should be where it says [s]."""
    in_effect = contract.dt if contract.interpolate else 0.5 * contract.dt
    return contract.delay + in_effect


def commanded_joints(action: Any, default_q: Any, scale: Any, q_min: Any, q_max: Any, xp: Any) -> Any:
    """Return the commanded joint positions (..., 12) [rad] for clipped actions (..., 12), NumPy or PyTorch."""
    return xp.clip(default_q + scale * action, q_min, q_max)


def joint_command(contract: PolicyContract, action: FloatArray) -> FloatArray:
    """Return the commanded joint positions (12,) [rad] for an action (12,)."""
    clipped = np.clip(action, -contract.action_clip, contract.action_clip)
    scale = np.array(contract.action_scale)
    default_q = np.array(contract.default_q)
    return commanded_joints(clipped, default_q, scale, np.array(contract.q_min), np.array(contract.q_max), np)


def heading_error(quat_WB: Any, heading_des: Any, xp: Any) -> Any:
    """Return the desired heading (...,) less that of the base (..., 4), wxyz, within pi [rad]; NumPy or PyTorch."""
    sine, cosine = heading_sin_cos(*(quat_WB[..., i] for i in range(4)))
    error = heading_des - xp.arctan2(sine, cosine)
    return xp.arctan2(xp.sin(error), xp.cos(error))


def next_gait(gait: Any, v_des: Any, error: Any, contract: PolicyContract, xp: Any) -> Any:
    """Return how far the robot is asked to step, 0 standing to 1, one control step later; NumPy or PyTorch.

    Args:
        gait: The same of the control step before (...,).
        v_des: Desired velocity (..., 2) [m/s].
        error: Of the heading (...,) [rad].
        contract: Says when to step, and how fast the clock fades.
        xp: ``numpy`` or ``torch``.
    """
    if contract.clock_fade <= 0.0:
        return xp.ones_like(gait)
    walks = (v_des**2).sum(-1) > contract.walk_speed**2
    turns = abs(error) > contract.walk_turn * (1 - 0.5 * gait)
    change = contract.dt / contract.clock_fade
    return xp.clip(gait + xp.where(walks | turns, change, -change), 0.0, 1.0)


def observation_frame(
    *,
    terms: tuple[tuple[str, int], ...],
    q_offset: Any,
    quat_WB: Any,
    last_action: Any,
    v_des: Any,
    error: Any,
    toes_des: Any,
    phase: Any,
    gait: Any,
    omega_B: Any,
    dq: Any,
    xp: Any,
) -> Any:
    """Return one frame (..., width) without its slow mean, which `with_slow_mean` adds; NumPy or PyTorch.

    Args:
        terms: Of the contract.
        q_offset: Joint positions - default pose (..., 12) [rad].
        quat_WB: Orientation of the base (..., 4), wxyz.
        last_action: Clipped action of the step before (..., 12).
        v_des: Desired velocity in the heading frame (..., 2) [m/s].
        error: Of the heading (...,) [rad], from `heading_error`.
        toes_des: Desired base -> front toe (..., 6) [m].
        phase: Gait phase (...,) [rad].
        gait: How far it is asked to step (...,), from `next_gait`.
        omega_B: Angular velocity of the base, base axes (..., 3) [rad/s].
        dq: Joint velocities (..., 12) [rad/s].
        xp: ``numpy`` or ``torch``.
    """
    down, forward = world_axes_in_base(*(quat_WB[..., i] for i in range(4)))
    pieces = {
        "joint_position": q_offset,
        "down": xp.stack([*down], -1),
        "forward": xp.stack([*forward], -1),
        "last_action": last_action,
        "velocity_command": v_des,
        "heading_error": xp.clip(error, -1.0, 1.0)[..., None],
        "toe_command": toes_des,
        "clock": xp.stack([gait * xp.sin(phase), gait * xp.cos(phase)], -1),
        "gyro": xp.clip(GYRO_SCALE * omega_B, -GYRO_CLIP, GYRO_CLIP),
        "joint_velocity": xp.clip(DQ_SCALE * dq, -DQ_CLIP, DQ_CLIP),
    }
    return xp.concatenate([pieces[name] for name, _ in terms if name in pieces], -1)


def with_slow_mean(frame: Any, slow: Any, columns: Any, dt: float, xp: Any) -> tuple[Any, Any]:
    """Return the whole frame (..., width), and the slow mean that it ends with (..., averaged); NumPy or PyTorch.

    Args:
        frame: As the policy senses it, without the slow mean (..., width less that).
        slow: The slow mean of the step before (..., averaged); at the first step the columns themselves.
        columns: Where the averaged terms stand in a frame (averaged,).
        dt: Control step [s].
        xp: ``numpy`` or ``torch``.
    """
    slow = slow + (frame[..., columns] - slow) * (dt / SLOW_SECONDS)
    return xp.concatenate([frame, slow], -1), slow


def arm_reference(q: Any, dq: Any, known: Any, default_q: Any, xp: Any) -> Any:
    """Return ARM_TERMS (..., 49), NumPy or PyTorch.

    Args:
        q: Joint positions of the front legs at the times AHEAD (..., 4, 6) [rad].
        dq: Their velocities then (..., 4, 6) [rad/s].
        known: 1 where the future is known, else 0 (...,).
        default_q: Joint positions of the front legs of a zero action (6,) [rad].
        xp: ``numpy`` or ``torch``.
    """
    share = xp.stack([xp.ones_like(known), *[known] * (len(AHEAD) - 1)], -1)[..., None]
    now = q[..., :1, :]
    positions = now + share * (q - now) - default_q
    both = xp.concatenate([positions, DQ_SCALE * share * dq], -1)
    return xp.concatenate([both.reshape(*both.shape[:-2], ARM_TERMS[0][1]), known[..., None]], -1)


def push_frame(history: Any, frame: Any, xp: Any) -> Any:
    """Return the history (..., frames, width) with its oldest frame dropped and ``frame`` appended."""
    return xp.concatenate([history[..., 1:, :], frame[..., None, :]], -2)


class ObservationBuilder:
    """Keeps the frames of one robot and returns its observation at each control step."""

    def __init__(self, contract: PolicyContract) -> None:
        self._contract = contract
        self._default = np.array(contract.default_q)
        self._frames: FloatArray | None = None
        self._last_action: FloatArray = np.zeros(len(contract.joints))
        self._steps = 0
        self._gait = np.zeros(())
        averaged = AVERAGED if contract.columns("slow_mean").size else ()
        self._averaged: IntArray = contract.columns(*averaged)
        self._slow: FloatArray | None = None
        self._arms: FloatArray | None = None

    @property
    def steps(self) -> int:
        """Control steps since the start."""
        return self._steps

    def observe(
        self,
        *,
        q: FloatArray,
        quat_WB: FloatArray,
        v_des: FloatArray,
        heading_des: float,
        p_BE_des: FloatArray,
        omega_B: FloatArray,
        dq: FloatArray,
        arms: FloatArray | None = None,
    ) -> FloatArray:
        """Return the observation (observation_size,) of this control step.

        Args:
            q: Joint positions (12,) [rad].
            quat_WB: Orientation of the base (4,), wxyz.
            v_des: Desired velocity in the heading frame (2,) [m/s].
            heading_des: Desired heading, world [rad].
            p_BE_des: Desired base -> front toe (2, 3) [m].
            omega_B: Angular velocity of the base, base axes (3,) [rad/s].
            dq: Joint velocities (12,) [rad/s].
            arms: `arm_reference` (49,); None while the policy moves the front legs.
        """
        self._arms = arms
        error = heading_error(quat_WB, heading_des, np)
        self._gait = next_gait(self._gait, np.asarray(v_des), error, self._contract, np)
        frame = observation_frame(
            terms=self._contract.terms,
            q_offset=q - self._default,
            quat_WB=quat_WB,
            last_action=self._last_action,
            v_des=np.asarray(v_des),
            error=error,
            toes_des=np.asarray(p_BE_des).reshape(6),
            phase=np.asarray(2 * np.pi * self._contract.clock_hz * self._contract.dt * self._steps),
            gait=self._gait,
            omega_B=omega_B,
            dq=dq,
            xp=np,
        )
        if self._averaged.size:
            before = frame[self._averaged] if self._slow is None else self._slow
            frame, self._slow = with_slow_mean(frame, before, self._averaged, self._contract.dt, np)
        if self._frames is None:
            frames = np.repeat(frame[None, :], self._contract.history, axis=0)
        else:
            frames = push_frame(self._frames, frame, np)
        self._frames = frames
        self._steps += 1
        if not self._contract.once:
            return frames.reshape(-1)
        standing = np.zeros((len(AHEAD), FRONT))
        at_rest = arm_reference(standing, standing, np.ones(()), 0.0, np)
        return np.concatenate([frames.reshape(-1), at_rest if arms is None else arms])

    def acted(self, action: FloatArray) -> None:
        """Tell the builder what the policy answered (12,)."""
        self._last_action = np.clip(action, -self._contract.action_clip, self._contract.action_clip)
        if self._contract.once and self._arms is not None:
            self._last_action[:FRONT] = 0.0
