"""From lying without power into the crouch: the ramp, the check of the hand-over, and the test of joints, legs, IMU."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from lab.policies.disturbed import Disturbance, DisturbedPlant
from lab.policies.standing import standing_track
from mimic.config.play import NOMINAL
from mimic.control.joint_test import JointTest, Mistake
from mimic.control.loop import run_policy
from mimic.control.safety.supervisor import SafetyMode, Supervisor
from mimic.control.start import not_crouched, too_busy, too_slow
from mimic.control.tick import Safety
from mimic.evaluation.episode import TIMING, play_episode
from mimic.metrics import stand_up_time
from mimic.policy.runtime import load_policy
from mimic.records import JOINTS, PHASES, JointCommand, RobotState, Tick
from mimic.robot.description import load_description
from mimic.simulation.plant import SimulatedPlant

ROBOTS = {name: load_description(name) for name in ("cyberdog2", "go2")}
LIE = PHASES.index("lie")


@dataclass
class Miswired:
    """A simulated robot of which joints are taken for what they are not, and whose IMU is turned."""

    plant: SimulatedPlant
    order: np.ndarray
    sign: np.ndarray
    turn: Rotation

    @property
    def description(self):
        return self.plant.description

    def start(self) -> RobotState:
        return self._read(self.plant.start())

    def step(self, command: JointCommand) -> Tick:
        lie = self.description.poses["lie"]
        q_des = lie.copy()
        q_des[self.order] += self.sign * (command.q_des - lie)
        tick = self.plant.step(dataclasses.replace(command, q_des=q_des))
        return dataclasses.replace(tick, state=self._read(tick.state), sent=command)

    def damp(self) -> bool:
        return self.plant.damp()

    def close(self) -> None:
        self.plant.close()

    def _read(self, state: RobotState) -> RobotState:
        lie = self.description.poses["lie"]
        quat = (Rotation.from_quat(state.quat_WB, scalar_first=True) * self.turn).as_quat(scalar_first=True)
        q = lie + self.sign * (state.q - lie)[self.order]
        dq, tau = (self.sign * values[self.order] for values in (state.dq, state.tau))
        return dataclasses.replace(state, q=q, dq=dq, tau=tau, quat_WB=quat)


def miswired(robot: str, *, friction: float = 1.0, flip: str = "", swap: tuple[str, str] = ("", ""), turn=(0, 0, 0)):
    """Return a robot with a sign, two joints or two legs (by their names) exchanged, its IMU turned [deg]."""
    order, sign = np.arange(12), np.ones(12)
    if flip:
        sign[JOINTS.index(flip)] = -1.0
    own, other = ([i for i, name in enumerate(JOINTS) if part and name.startswith(part)] for part in swap)
    order[own + other] = other + own
    ranges = dataclasses.replace(NOMINAL, ground_friction=(friction, friction))
    plant = SimulatedPlant(ROBOTS[robot], ranges=ranges, samples=False)
    return Miswired(plant, order, sign, Rotation.from_euler("xyz", turn, degrees=True))


def played(plant, *, seconds: float = 2.5, **options):
    policy = load_policy(None, plant.description)
    safety = Safety(supervisor=Supervisor(plant.description, sits=False), damp_at_end=False, **options)
    return run_policy(plant, policy, standing_track(policy, seconds), TIMING, safety=safety)


def decisive(result) -> tuple[str, SafetyMode, str]:
    event = next(event for event in result.events if event.mode > SafetyMode.RUN)
    return event.rule, event.mode, event.text


@pytest.mark.parametrize(("robot", "friction"), [("cyberdog2", 1.2), ("go2", 0.4)])
def test_a_limp_robot_whose_joints_are_tested_is_handed_over_in_the_crouch_and_stands_up(robot, friction):
    result = played(miswired(robot, friction=friction))
    assert decisive(result)[0] == "finished"
    log, d = result.log, ROBOTS[robot]
    lying = log.phase == LIE
    assert np.abs(log.q[0] - d.poses["lie"]).max() > 0.3, "it lies without power"
    assert np.abs(log.q[~lying][0] - d.poses["lie"]).max() < 0.1
    assert stand_up_time(log, d) < 1.0
    assert np.abs(log.tau[lying]).max() < 0.9 * d.torque_max.min()


SHIFTED = [
    ({"flip": "FL_abad"}, "the sign of FL_abad is wrong"),
    ({"swap": ("RL_hip", "RL_knee")}, "the motors RL_hip and RL_knee are swapped"),
    ({"swap": ("FL", "RR")}, "the legs FL and RR are swapped"),
    ({"turn": (-10, 0, 0)}, "the IMU shows a tilt of "),
    ({"turn": (0, 0, 10)}, "the IMU is turned by "),
]


@pytest.mark.parametrize(("mistake", "text"), SHIFTED, ids=[text for _, text in SHIFTED])
def test_a_mistake_in_the_wiring_is_named_and_the_robot_damped_on_the_ground(mistake, text):
    result = played(miswired("cyberdog2", **mistake))
    rule, mode, found = decisive(result)
    assert (rule, mode) == ("start", SafetyMode.DAMP)
    assert found.startswith(text)
    assert found.endswith("it was damped on the ground")
    assert set(result.log.phase) == {LIE, PHASES.index("damp")}
    assert result.log.p_WB[:, 2].max() < 1.2 * ROBOTS["cyberdog2"].pose_height["lie"]


def test_swapped_legs_of_a_go2_are_named():
    assert decisive(played(miswired("go2", swap=("RL", "RR"))))[2].startswith("the legs RL and RR are swapped")


def test_a_joint_that_does_not_move_is_named():
    plant = miswired("cyberdog2")
    step = plant.step
    plant.step = lambda command: step(dataclasses.replace(command, kp=command.kp * (np.arange(12) != 7)))
    assert "RL_hip" in decisive(played(plant))[2]


def test_a_ramp_that_is_too_soft_is_refused_at_the_hand_over():
    soft = dataclasses.replace(ROBOTS["go2"], start=dataclasses.replace(ROBOTS["go2"].start, kp=15.0, kd=1.0))
    rule, mode, text = decisive(played(SimulatedPlant(soft, samples=False), tested=False))
    assert (rule, mode) == ("start", SafetyMode.DAMP)
    assert "deg from the crouch, at most 8 may be" in text


def test_an_episode_of_an_evaluation_begins_where_the_ramp_ends_and_is_not_refused():
    policy = load_policy(None, ROBOTS["cyberdog2"])
    tilted = DisturbedPlant(
        ROBOTS["cyberdog2"], samples=False, begin=-2.5, disturbance=Disturbance(imu_tilt=8.0, imu_axis="pitch")
    )
    log = play_episode(tilted, policy, standing_track(policy, 2.0), TIMING).log
    assert log.t[0] == pytest.approx(0.0, abs=1e-9)
    assert LIE not in log.phase
    assert "tilt" in not_crouched(
        RobotState(**{name: getattr(log, name)[0] for name in RobotState.__dataclass_fields__}), ROBOTS["cyberdog2"]
    )


def test_each_mistake_that_is_looked_for_touches_its_own_joints():
    test = JointTest(ROBOTS["go2"])
    none, *others = test.mistakes
    assert none.touches.size == 0
    assert len(others) == 12 + 12 + 6
    assert sorted({len(mistake.touches) for mistake in others}) == [1, 2, 6]
    assert isinstance(none, Mistake)


def test_a_computer_that_is_late_while_the_robot_lies_is_too_busy_to_hold_it_up():
    late = np.zeros(400)
    assert too_busy(late) == ""
    late[::20] = 0.03
    assert too_busy(late) == ""
    late = np.zeros(400)
    late[::8] = 0.03
    assert "12% of the control steps came more than 5 ms late, by up to 30 ms" in too_busy(late)


def test_a_bus_whose_answers_come_late_while_the_robot_lies_is_too_slow_to_hold_it_up():
    missed = np.zeros((200, 12))
    missed[::40] = 1
    assert too_slow(missed) == ""
    missed[::10] = 2
    assert too_slow(missed).startswith("10% of the motors' answers did not come within their control step, at most 4%")
    assert too_slow(np.full((200, 12), np.nan)) == ""
