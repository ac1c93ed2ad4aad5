"""The rules by which a robot is stopped: one function and one row of the table each, limits with their reasons beside them.

Healthy extremes are those of 120 robots of the paper's Table II that stood up, followed random commands and sat down
(benchmarks/safety_envelope.py), the IMU read in steps of an MTi.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np

from mimic.frames import rotation_from_quat
from mimic.heat import MotorHeat
from mimic.metrics import uprightness
from mimic.robot.description import RobotDescription
from mimic.robot.leg import all_toes
from mimic.types import JOINTS, PHASES, FloatArray, Health, RobotState

STANDING = ("blend", "track", "hold")
"""Phases in which the robot should be upright."""

MOVING = ("stand_up", *STANDING, "sit_down")
"""Phases in which a policy moves it."""


@dataclass(frozen=True, kw_only=True)
class Limits:
    """Where each rule draws its line, and why there."""

    silent_ticks: int = 3
    """Control steps without an answer: 60 ms. One lost frame is common, three in a row are a broken wire."""
    silent_seconds: float = 0.055
    """… and this long [s]: after a late tick some may follow at once, in which nobody had the time to answer."""
    lost_motors: int = 1
    """With one motor lost the other eleven may still bring the robot down; with two nobody has tried."""
    temperature_announced: float = 65.0
    """[degC] Ten below the motor's own warning."""
    temperature: float = 72.0
    """[degC] The motor warns at 75 and faults at 80; sitting down takes seconds and should end before that."""
    rise_announced: float = 0.85
    """Of the winding's limit, by the thermal model."""
    rise: float = 0.95
    """… at which it sits down, which takes 2.5 s."""
    outside: float = 0.2
    """Joint reading beyond its limit [rad]; healthy none, with an earlier policy 0.02. Such a pose does not exist: the zero is wrong."""
    jump: float = 0.8
    """Change of a joint between two ticks [rad]; healthy most 0.45, and no motor turns faster than 0.62 in 20 ms."""
    imu_age: float = 0.06
    """[s] Three ticks."""
    imu_same: int = 3
    """Orientations in a row with the same content while a policy moves the robot; healthy most 1."""
    imu_turn: float = 0.12
    """Difference between the turn of the orientation and the rate of turn, per 20 ms [rad]; healthy most 0.023, with
    earlier policies 0.042."""
    toes_apart: float = 0.10
    """Difference in height of the hind toes by legs and IMU while standing [m]; healthy most 0.082 as it steps, 0.062 for
    three ticks in a row, which it takes; a foot of a robot that rolls by 0.37 rad is this much above the other one."""
    toes_apart_moving: float = 0.2
    """… while standing up and sitting down; healthy most 0.086."""
    front_above: float = 0.1
    """Height of the lower front toe over the lower hind toe while standing, at least [m]; healthy least 0.29."""
    legs_ticks: int = 3
    """Ticks in a row with legs and IMU apart: 60 ms; a foot may be lifted for one."""
    upright: float = 0.85
    """Cosine between base x and the upright direction; healthy least 0.975, pushed 0.94. All 70 falls of 400 episodes, half
    of them pushed, pass it, 0.18 s before the robot is beyond help."""
    side_tilt: float = 0.75
    """Sine of the base's roll while standing up, sitting down or lying; healthy most 0.30."""
    backward: float = -0.5
    """Up component of base z, while standing up or sitting down: below, the robot is on its way onto its back; healthy
    least -0.11."""
    late: float = 0.010
    """[s] Half a control step."""
    late_ticks: int = 3
    """Steps in a row that late."""
    slow: float = 0.002
    """[s] A tenth of a control step."""
    slow_told: int = 3
    slow_ticks: int = 25
    """Steps in a row that slow: half a second. The policy was trained with delays of up to 35 ms, so 2 ms do no harm by
    themselves; lasting, they say that the computer cannot keep up."""
    gap: float = 0.1
    """[s] One step that late, five control steps without a command."""
    bus_errors: int = 12
    """Error frames within a tenth of a second: one for each motor."""
    rest_speed: float = 0.1
    """[rad/s] A joint slower than this rests."""
    rest_seconds: float = 0.5
    """[s]"""
    damp_seconds: float = 8.0
    """[s] An upright robot that is only damped, with 5 N m s/rad, comes to rest within 6.4 s."""
    interrupts_stop: int = 4
    """Ctrl-C this often switches a damped robot off before it rests."""


LIMITS = Limits()


@dataclass(frozen=True, kw_only=True, eq=False)
class Facts:
    """What a supervisor is told after a control step."""

    state: RobotState
    health: Health
    phase: int
    """Index into PHASES."""
    interrupts: int = 0
    """How often Ctrl-C was pressed."""
    terminated: bool = False
    """Whether the process was asked to end."""


@dataclass(frozen=True, kw_only=True)
class Finding:
    """What a rule found in one control step."""

    outcome: Literal["RUN", "SIT_DOWN", "DAMP"]
    text: str
    about: str = ""
    """What it is about, such as a joint: it is told once for each."""
    needs_upright: bool = True
    """Whether sitting down makes sense only for a robot that is still upright."""


class Watch:
    """What has to be remembered from one control step to the next."""

    def __init__(self, description: RobotDescription, limits: Limits) -> None:
        self.description, self._limits = description, limits
        self.lost: set[int] = set()
        """Joints that cannot be relied on any more."""
        self.unbelieved: set[int] = set()
        """Joints whose positions are not believed any more."""
        self.heat: MotorHeat | None = None
        self.rise: FloatArray = np.zeros(len(JOINTS))
        self.jump: FloatArray = np.zeros(len(JOINTS))
        self.same = self.apart = self.late = self.slow = 0
        self.turn_mismatch = 0.0
        """Turn of the orientation less that of the rate of turn, per 20 ms [rad]."""
        self.hind_apart = self.front_above = float("nan")
        self._errors: list[tuple[float, int]] = []
        self._before: tuple[float, RobotState, Health] | None = None
        self._q = np.full(len(JOINTS), np.nan)

    def hear(self, facts: Facts) -> None:
        """Take a step of a damped robot: only heat goes on."""
        self._warm(facts)
        self._before = (facts.state.t, facts.state, facts.health)

    def see(self, facts: Facts) -> None:
        """Take a step."""
        state, health, limits = facts.state, facts.health, self._limits
        self._warm(facts)
        self.jump = np.abs(state.q - self._q)
        self._q = state.q
        self.late = self.late + 1 if health.late > limits.late else 0
        self.slow = self.slow + 1 if health.late > limits.slow else 0
        self._errors = [(t, n) for t, n in self._errors if t > state.t - 0.1] + [(state.t, health.bus_errors)]
        self._compare_imu(facts)
        self._compare_legs(facts)
        self._before = (state.t, state, health)

    @property
    def new_errors(self) -> int:
        """Error frames of the last tenth of a second."""
        return self._errors[-1][1] - self._errors[0][1]

    def _warm(self, facts: Facts) -> None:
        if self.heat is None:
            self.heat = MotorHeat(self.description, facts.health.temperature)
        step = 0.0 if self._before is None else max(facts.state.t - self._before[0], 0.0)
        self.rise = self.heat.add(facts.state.tau, step)

    def _compare_imu(self, facts: Facts) -> None:
        """Compare an orientation with the one before: the same content, or another turn than the rates say."""
        self.turn_mismatch = 0.0
        if self._before is None:
            return
        t, before, health = self._before
        if facts.health.imu_count == health.imu_count:
            return
        state = facts.state
        seconds = (state.t - facts.health.imu_age) - (t - health.imu_age)
        known = np.isfinite(np.concatenate([state.quat_WB, before.quat_WB, state.omega_B, before.omega_B])).all()
        if not known or seconds <= 0.0:
            return
        equal = np.array_equal(state.quat_WB, before.quat_WB) and np.array_equal(state.omega_B, before.omega_B)
        self.same = self.same + 1 if equal else 0
        change = rotation_from_quat(before.quat_WB).T @ rotation_from_quat(state.quat_WB)
        turned = 0.5 * np.array([change[2, 1] - change[1, 2], change[0, 2] - change[2, 0], change[1, 0] - change[0, 1]])
        said = 0.5 * seconds * (state.omega_B + before.omega_B)
        steps = max(1.0, seconds / self.description.dt)
        self.turn_mismatch = float(np.linalg.norm(turned - said)) / steps

    def _compare_legs(self, facts: Facts) -> None:
        """Work out how high the toes are against each other, by legs and IMU."""
        state, limits = facts.state, self._limits
        q = state.q.copy()
        q[list(self.unbelieved)] = np.nan
        toes = all_toes(q, self.description) @ rotation_from_quat(state.quat_WB)[2]
        self.hind_apart = float(abs(toes[2] - toes[3]))
        self.front_above = float(toes[:2].min() - toes[2:].min())
        stands = PHASES[facts.phase] in STANDING
        apart = self.hind_apart > (limits.toes_apart if stands else limits.toes_apart_moving)
        kneels = stands and self.front_above < limits.front_above
        self.apart = self.apart + 1 if apart or kneels else 0


Check = Callable[[Facts, Watch, Limits], Iterator[Finding]]


@dataclass(frozen=True, kw_only=True)
class Rule:
    """A row of the table in docs/robot.md."""

    name: str
    limit: str
    """Where the line is, in words."""
    within: str
    """How soon it is noticed."""
    outcome: str
    check: Check


def _interrupt(facts: Facts, watch: Watch, limits: Limits) -> Iterator[Finding]:
    if facts.interrupts == 1:
        yield Finding(outcome="SIT_DOWN", text="Ctrl-C was pressed", needs_upright=False)
    elif facts.interrupts > 1:
        yield Finding(outcome="DAMP", text="Ctrl-C was pressed again")


def _terminated(facts: Facts, watch: Watch, limits: Limits) -> Iterator[Finding]:
    if facts.terminated:
        yield Finding(outcome="DAMP", text="the process was asked to end (SIGTERM)")


def _lost(joint: int, text: str, watch: Watch) -> Finding:
    watch.lost.add(joint)
    return Finding(outcome="SIT_DOWN", text=text, about=JOINTS[joint])


def _motor_silent(facts: Facts, watch: Watch, limits: Limits) -> Iterator[Finding]:
    health = facts.health
    silent = np.flatnonzero((health.missed >= limits.silent_ticks) & (health.age >= limits.silent_seconds))
    watch.lost.update(map(int, silent))
    for joint in silent:
        missed, age = int(health.missed[joint]), float(health.age[joint])
        yield _lost(int(joint), f"motor {JOINTS[joint]} has not answered for {missed} ticks ({age:.2f} s)", watch)


def _motor_fault(facts: Facts, watch: Watch, limits: Limits) -> Iterator[Finding]:
    faulty = np.flatnonzero(facts.health.faults)
    watch.lost.update(map(int, faulty))
    for joint in faulty:
        bits = int(facts.health.faults[joint])
        yield _lost(int(joint), f"motor {JOINTS[joint]} reports fault bits {bits:#04x}", watch)


def _motor_off(facts: Facts, watch: Watch, limits: Limits) -> Iterator[Finding]:
    off = np.flatnonzero(~facts.health.running & (facts.health.missed == 0) & (facts.health.faults == 0))
    watch.lost.update(map(int, off))
    watch.unbelieved.update(map(int, off))
    for joint in off:
        yield _lost(int(joint), f"motor {JOINTS[joint]} switched itself off, so its zero may be lost", watch)


def _motor_hot(facts: Facts, watch: Watch, limits: Limits) -> Iterator[Finding]:
    temperature = facts.health.temperature
    for joint in np.flatnonzero(temperature >= limits.temperature_announced):
        name, text = JOINTS[joint], f"motor {JOINTS[joint]} is at {temperature[joint]:.0f} degC"
        if temperature[joint] < limits.temperature:
            yield Finding(outcome="RUN", text=f"{text}; it sits down at {limits.temperature:g} degC", about=name)
        else:
            yield Finding(outcome="SIT_DOWN", text=text, about=name)


def _winding_hot(facts: Facts, watch: Watch, limits: Limits) -> Iterator[Finding]:
    for joint in np.flatnonzero(watch.rise >= limits.rise_announced):
        name, text = JOINTS[joint], f"the winding of {JOINTS[joint]} is at {watch.rise[joint]:.0%} of its limit"
        if watch.rise[joint] < limits.rise:
            yield Finding(outcome="RUN", text=f"{text} by the thermal model", about=name)
        else:
            yield Finding(outcome="SIT_DOWN", text=f"{text} by the thermal model", about=name)


def _joint_impossible(facts: Facts, watch: Watch, limits: Limits) -> Iterator[Finding]:
    description, q = watch.description, facts.state.q
    outside = np.maximum(q - description.q_max, description.q_min - q)
    bad = np.flatnonzero((outside > limits.outside) | (watch.jump > limits.jump))
    watch.lost.update(map(int, bad))
    watch.unbelieved.update(map(int, bad))
    for joint in bad:
        if outside[joint] > limits.outside:
            text = f"joint {JOINTS[joint]} reads {q[joint]:.2f} rad, {outside[joint]:.2f} rad beyond its limit"
        else:
            text = f"joint {JOINTS[joint]} jumped by {watch.jump[joint]:.2f} rad in one tick"
        yield _lost(int(joint), text, watch)


def _imu_silent(facts: Facts, watch: Watch, limits: Limits) -> Iterator[Finding]:
    if not facts.health.imu_age <= limits.imu_age:
        yield Finding(outcome="DAMP", text=f"the IMU has been silent for {facts.health.imu_age:.2f} s")


def _imu_frozen(facts: Facts, watch: Watch, limits: Limits) -> Iterator[Finding]:
    if PHASES[facts.phase] not in MOVING:
        return
    if watch.same >= limits.imu_same:
        yield Finding(outcome="DAMP", text=f"the IMU sent the same orientation {watch.same + 1} times")
    elif facts.health.imu_unchanged > limits.imu_age:
        text = f"nothing that the IMU sends has changed for {facts.health.imu_unchanged:.2f} s"
        yield Finding(outcome="DAMP", text=text)


def _imu_invalid(facts: Facts, watch: Watch, limits: Limits) -> Iterator[Finding]:
    if facts.health.imu_valid is False:
        yield Finding(outcome="DAMP", text="the IMU says that its orientation is not valid")


def _imu_contradicts_itself(facts: Facts, watch: Watch, limits: Limits) -> Iterator[Finding]:
    if watch.turn_mismatch > limits.imu_turn:
        text = f"orientation and rate of turn of the IMU disagree by {watch.turn_mismatch:.2f} rad in one tick"
        yield Finding(outcome="DAMP", text=text)


def _imu_contradicts_legs(facts: Facts, watch: Watch, limits: Limits) -> Iterator[Finding]:
    if PHASES[facts.phase] in MOVING and watch.apart >= limits.legs_ticks:
        yield Finding(
            outcome="DAMP",
            text=f"IMU and legs disagree: by them the hind toes differ in height by {watch.hind_apart:.2f} m, "
            f"and the front toes are {watch.front_above:.2f} m above the hind ones",
        )


def _degrees(cosine: float) -> int:
    return round(float(np.rad2deg(np.arccos(np.clip(cosine, -1.0, 1.0)))))


def _tipping(facts: Facts, watch: Watch, limits: Limits) -> Iterator[Finding]:
    if PHASES[facts.phase] in STANDING:
        upright = float(uprightness(facts.state.quat_WB, watch.description))
        if upright < limits.upright:
            yield Finding(outcome="DAMP", text=f"the robot is tipping over: {_degrees(upright)} deg from upright")


def _rolling_over(facts: Facts, watch: Watch, limits: Limits) -> Iterator[Finding]:
    if PHASES[facts.phase] not in STANDING:
        _, side, up = rotation_from_quat(facts.state.quat_WB)[2]
        if abs(side) > limits.side_tilt:
            degrees = np.rad2deg(np.arcsin(np.clip(abs(side), 0.0, 1.0)))
            yield Finding(outcome="DAMP", text=f"the robot is rolling over: {degrees:.0f} deg to the side")
        elif up < limits.backward:
            yield Finding(outcome="DAMP", text="the robot is falling onto its back")


def _tick_late(facts: Facts, watch: Watch, limits: Limits) -> Iterator[Finding]:
    late = 1e3 * facts.health.late
    if facts.health.late > limits.gap or watch.late >= limits.late_ticks:
        yield Finding(outcome="DAMP", text=f"ticks come too late: {late:.0f} ms, {watch.late} in a row")
    elif watch.slow >= limits.slow_ticks:
        yield Finding(outcome="DAMP", text=f"{watch.slow} ticks in a row were late, the last one by {late:.1f} ms")
    elif watch.late:
        yield Finding(outcome="RUN", text=f"a tick came {late:.0f} ms late", about="once")
    elif watch.slow == limits.slow_told:
        yield Finding(outcome="RUN", text=f"{watch.slow} ticks in a row were late, the last one by {late:.1f} ms")


def _bus_errors(facts: Facts, watch: Watch, limits: Limits) -> Iterator[Finding]:
    if watch.new_errors >= limits.bus_errors:
        yield Finding(outcome="DAMP", text=f"the bus had {watch.new_errors} errors within a tenth of a second")
    elif watch.new_errors:
        yield Finding(outcome="RUN", text=f"the bus had {watch.new_errors} errors")


def _guardian_gone(facts: Facts, watch: Watch, limits: Limits) -> Iterator[Finding]:
    if not facts.health.guarded:
        yield Finding(outcome="SIT_DOWN", text="the guardian process has ended", needs_upright=False)


_SIT = "sit down if upright and at most one motor is lost, else damp"
_L = LIMITS

RULES = tuple(
    Rule(name=check.__name__[1:], limit=limit, within=within, outcome=outcome, check=check)
    for check, limit, within, outcome in (
        (_interrupt, "Ctrl-C; again", "1 tick", "sit down; damp"),
        (_terminated, "SIGTERM", "1 tick", "damp"),
        (_motor_silent, f"{_L.silent_ticks} ticks without an answer", "60 ms", _SIT),
        (_motor_fault, "any fault bit", "1 tick", _SIT),
        (_motor_off, "not in run mode, without a fault", "1 tick", _SIT),
        (_motor_hot, f"{_L.temperature_announced:g} °C; {_L.temperature:g} °C", "1 tick", f"announce; {_SIT}"),
        (
            _winding_hot,
            f"{_L.rise_announced:.0%}; {_L.rise:.0%} of the winding's limit by the thermal model",
            "1 tick",
            f"announce; {_SIT}",
        ),
        (
            _joint_impossible,
            f"{_L.outside:g} rad beyond a joint limit, or {_L.jump:g} rad in one tick",
            "1 tick",
            _SIT,
        ),
        (_imu_silent, f"older than {1e3 * _L.imu_age:g} ms", "60 ms", "damp"),
        (
            _imu_frozen,
            f"{_L.imu_same + 1} equal readings, or nothing new for {1e3 * _L.imu_age:g} ms, while a policy moves the robot",
            "60 ms",
            "damp",
        ),
        (_imu_invalid, "its status says so", "1 tick", "damp"),
        (
            _imu_contradicts_itself,
            f"orientation and rate of turn differ by {_L.imu_turn:g} rad in a tick",
            "1 tick",
            "damp",
        ),
        (
            _imu_contradicts_legs,
            f"for {_L.legs_ticks} ticks, hind toes {100 * _L.toes_apart:g} cm apart in height while standing, "
            f"{100 * _L.toes_apart_moving:g} cm while getting up or down, or front toes less than "
            f"{100 * _L.front_above:g} cm above them while standing",
            "60 ms",
            "damp",
        ),
        (
            _tipping,
            f"cosine to upright below {_L.upright:g} ({_degrees(_L.upright)} deg) while standing",
            "1 tick",
            "damp",
        ),
        (
            _rolling_over,
            f"sine of the roll above {_L.side_tilt:g}, or base z below {_L.backward:g}, while getting up or down",
            "1 tick",
            "damp",
        ),
        (
            _tick_late,
            f"one {1e3 * _L.late:g} ms late, or {_L.slow_told} in a row {1e3 * _L.slow:g} ms; "
            f"{_L.late_ticks} in a row {1e3 * _L.late:g} ms, {_L.slow_ticks} in a row {1e3 * _L.slow:g} ms, "
            f"or one {1e3 * _L.gap:g} ms",
            "1 tick",
            "log; damp",
        ),
        (_bus_errors, f"any; {_L.bus_errors} within 0.1 s", "0.1 s", "log; damp"),
        (_guardian_gone, "it has ended", "1 tick", "sit down"),
    )
)
"""Every rule that looks at readings, in the order in which they are tried."""

HUNG_RULES = tuple(rule for rule in RULES if not rule.name.startswith(("imu", "tipping", "rolling")))
"""Those for a robot that hangs and needs no balance."""

ELSEWHERE = {
    "not_finite": "a target or an answer of the policy is not a number: damped in the same tick",
    "outside_limits": "targets, answers and commands beyond their limits: clamped in the same tick, counted",
    "exception": "anything raised anywhere, the bus among it: damped, then stopped",
    "finished": "the run is over: damped, then stopped",
    "at_rest": "damped and slower than 0.1 rad/s for 0.5 s, or damped for 8 s: stopped",
}
"""Rules that the loop itself applies, in words."""
