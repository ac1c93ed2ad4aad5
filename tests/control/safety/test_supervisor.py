"""Each rule of the table: what it lets pass, what it stops, and how."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mimic.control.safety.safety_rules import FAILURE, RULES
from mimic.control.safety.step_history import StepReport
from mimic.control.safety.supervisor import SafetyMode, Supervisor
from mimic.records import JOINTS, PHASES, Health, RobotState
from mimic.robot.description import load_description

DT = 0.02
LIMITS = load_description("cyberdog2").safety
UPRIGHT = Rotation.from_euler("Y", -np.pi / 2 + np.arctan2(0.2, 1.0))
"""Orientation in which the robot stands: base x leans forward by 11.3 deg."""

HEALTHY = Health(
    age=np.full(12, 0.018),
    missed=np.zeros(12, dtype=int),
    faults=np.zeros(12, dtype=int),
    running=np.ones(12, dtype=bool),
    temperature=np.full(12, 40.0),
    imu_age=0.005,
    imu_unchanged=0.005,
    imu_count=0,
    imu_valid=True,
    compute=0.001,
    late=0.0,
    bus_errors=0,
)


def at(joint: str, value, base=0):
    values = np.full(12, base, dtype=np.result_type(type(value), type(base)))
    values[JOINTS.index(joint)] = value
    return values


@pytest.fixture
def drive(description) -> Callable[..., Supervisor]:
    """Return a function that drives a supervisor over ticks, each described by what differs from a healthy stance."""

    def run(
        ticks: list[dict],
        *,
        phase: str = "track",
        turn: Callable[[int], Rotation] | None = None,
        supervisor: Supervisor | None = None,
        first: int = 0,
    ) -> Supervisor:
        supervisor = supervisor or Supervisor(description)
        for number, given in enumerate(ticks, start=first):
            tick = dict(given)
            name = tick.pop("phase", phase)
            lying = name in ("lie", "damp")
            # a robot that moves: it nods by a few milliradians, as the rate of turn answer
            nod, rate = 0.002 * np.sin(5 * number * DT), 0.01 * np.cos(5 * number * DT)
            stance = Rotation.identity() if lying else UPRIGHT * Rotation.from_euler("Y", nod)
            if turn is not None:
                stance = turn(number)
            state = RobotState(
                t=number * DT,
                q=tick.pop("q", description.poses["lie" if lying else "upright"]),
                dq=tick.pop("dq", np.zeros(12)),
                tau=tick.pop("tau", np.full(12, 2.0)),
                quat_WB=tick.pop("quat_WB", stance.as_quat(scalar_first=True)),
                omega_B=tick.pop("omega_B", np.array([0.0, rate, 0.0])),
                p_WB=np.full(3, np.nan),
                v_WB=np.full(3, np.nan),
            )
            said = {k: tick.pop(k) for k in ("interrupts", "terminated", "released", "q_des") if k in tick}
            tick.setdefault("age", 0.018 + DT * np.asarray(tick.get("missed", HEALTHY.missed)))
            health = dataclasses.replace(HEALTHY, **{"imu_count": number, **tick})
            supervisor.update(StepReport(state=state, health=health, phase=PHASES.index(name), **said))
        return supervisor

    return run


def outcome(supervisor: Supervisor) -> tuple[str, SafetyMode]:
    assert supervisor.decisive is not None, [e.text for e in supervisor.events]
    return supervisor.decisive.rule, supervisor.mode


def test_a_healthy_robot_runs_on_and_nothing_is_logged(drive):
    supervisor = drive([{}] * 200)
    assert supervisor.mode == SafetyMode.RUN
    assert not supervisor.events


@pytest.mark.parametrize("phase", ["lie", "stand_up", "blend", "track", "hold", "sit_down"])
def test_a_healthy_robot_runs_on_in_every_phase(phase, drive):
    assert drive([{}] * 20, phase=phase).mode == SafetyMode.RUN


# ---------------------------------------------------------------------- requests to stop


@pytest.mark.parametrize("phase", ["stand_up", "blend", "track", "hold", "sit_down"])
def test_ctrl_c_sits_down_within_a_tick_and_another_one_damps(phase, drive):
    supervisor = drive([{}, {"interrupts": 1}], phase=phase)
    assert outcome(supervisor) == ("asked_to_end", SafetyMode.SIT_DOWN)
    drive([{"interrupts": 1}] * 3, phase="sit_down", supervisor=supervisor, first=2)
    assert supervisor.mode == SafetyMode.SIT_DOWN
    drive([{"interrupts": 2}], phase="sit_down", supervisor=supervisor, first=5)
    assert supervisor.mode == SafetyMode.DAMP


def test_ctrl_c_while_it_still_lies_damps(drive):
    assert outcome(drive([{"interrupts": 1}], phase="lie")) == ("asked_to_end", SafetyMode.DAMP)


def test_sigterm_damps_within_a_tick(drive):
    assert outcome(drive([{}, {"terminated": True}])) == ("asked_to_end", SafetyMode.DAMP)


def test_what_must_be_held_and_is_let_go_makes_it_sit_down(drive):
    assert outcome(drive([{}, {"released": True}])) == ("asked_to_end", SafetyMode.SIT_DOWN)


@pytest.mark.parametrize("given", [{"late": 0.011}, {"bus_errors": 1}, {"temperature": np.full(12, 66.0)}])
def test_on_a_rope_it_sits_down_at_what_is_otherwise_announced(given, drive, description):
    ticks = [{}, {}, given]
    assert drive(ticks).mode == SafetyMode.RUN
    assert drive(ticks, supervisor=Supervisor(description, strict=True)).mode == SafetyMode.SIT_DOWN


# ---------------------------------------------------------------------- motors


@pytest.mark.parametrize("joint", JOINTS)
def test_a_motor_that_misses_five_ticks_makes_it_sit_down(joint, drive, description):
    unknown = description.poses["upright"] + at(joint, np.nan, 0.0)
    missing = [{"missed": at(joint, n), "q": unknown} for n in (1, 2, 3, 4)]
    assert drive(missing).mode == SafetyMode.RUN
    supervisor = drive([{}, *missing, {"missed": at(joint, 5), "q": unknown}])
    assert outcome(supervisor) == ("motor_silent", SafetyMode.SIT_DOWN)
    assert joint in supervisor.decisive.text


def test_five_ticks_that_follow_each_other_at_once_are_not_yet_silence(drive):
    hurried = {"missed": at("FL_knee", 5), "age": np.full(12, 0.03)}
    assert drive([hurried] * 2).mode == SafetyMode.RUN


def test_two_silent_motors_damp(drive):
    missed = at("FL_knee", 5) + at("RR_hip", 5)
    assert outcome(drive([{"missed": missed}])) == ("motor_silent", SafetyMode.DAMP)


def test_a_second_motor_lost_while_it_sits_down_damps(drive):
    supervisor = drive([{"missed": at("FL_knee", 5)}])
    drive([{"missed": at("FL_knee", 6)}] * 5, phase="sit_down", supervisor=supervisor, first=1)
    assert supervisor.mode == SafetyMode.SIT_DOWN
    drive([{"missed": at("FL_knee", 9), "faults": at("RL_hip", 1)}], phase="sit_down", supervisor=supervisor, first=6)
    assert supervisor.mode == SafetyMode.DAMP


@pytest.mark.parametrize("phase", ["lie", "stand_up"])
def test_a_motor_lost_before_it_is_upright_damps(phase, drive):
    turn = None if phase == "lie" else lambda tick: Rotation.from_euler("Y", -0.5)
    supervisor = drive([{"missed": at("FL_knee", 5)}], phase=phase, turn=turn)
    assert outcome(supervisor) == ("motor_silent", SafetyMode.DAMP)


@pytest.mark.parametrize("bit", [1, 2, 4, 8, 16, 32, 64])
def test_a_fault_bit_makes_it_sit_down_within_a_tick(bit, drive):
    supervisor = drive([{}, {"faults": at("RR_knee", bit)}])
    assert outcome(supervisor) == ("motor_failed", SafetyMode.SIT_DOWN)
    assert "RR_knee" in supervisor.decisive.text


def test_a_motor_that_switched_itself_off_makes_it_sit_down(drive):
    running = at("FL_hip", 0, 1).astype(bool)
    assert outcome(drive([{}, {"running": running}])) == ("motor_failed", SafetyMode.SIT_DOWN)


def test_a_warm_motor_is_logged_once_and_a_hot_one_makes_it_sit_down(drive):
    warm = {"temperature": at("RL_knee", 68.0, 40.0)}
    supervisor = drive([warm] * 5)
    assert supervisor.mode == SafetyMode.RUN
    assert [e.rule for e in supervisor.events] == ["too_hot"]
    drive([{"temperature": at("RL_knee", 72.0, 40.0)}], supervisor=supervisor, first=5)
    assert outcome(supervisor) == ("too_hot", SafetyMode.SIT_DOWN)


def test_the_thermal_model_logs_a_hot_winding_and_then_makes_it_sit_down(drive):
    loaded = {"tau": at("RL_knee", 12.0, 0.0)}  # the overload table allows 28 s of it
    supervisor = drive([loaded] * 1500)
    assert outcome(supervisor) == ("too_hot", SafetyMode.SIT_DOWN)
    announced, decided = supervisor.events
    assert announced.mode == SafetyMode.RUN
    assert announced.t < decided.t < 28.0
    assert "RL_knee" in decided.text


@pytest.mark.parametrize("change", [0.9, -0.9])
def test_a_joint_that_jumps_is_distrusted(change, drive, description):
    q = description.poses["upright"].copy()
    q[JOINTS.index("FL_hip")] += change
    assert outcome(drive([{}, {"q": q}])) == ("joint_impossible", SafetyMode.SIT_DOWN)


def test_a_joint_beyond_its_limit_is_distrusted(drive, description):
    q = description.poses["upright"].copy()
    q[JOINTS.index("FR_abad")] = description.q_max[JOINTS.index("FR_abad")] + 0.25
    assert outcome(drive([{"q": q}])) == ("joint_impossible", SafetyMode.SIT_DOWN)


@pytest.mark.parametrize(("steps", "mode"), [(15, SafetyMode.RUN), (16, SafetyMode.SIT_DOWN)])
def test_a_joint_that_reads_the_same_while_its_target_moves_is_distrusted(steps, mode, drive, description):
    q = description.poses["upright"]
    ticks = [{"q": q, "q_des": q + at("RL_hip", 0.02 * tick, 0.0)} for tick in range(steps)]
    supervisor = drive(ticks)
    assert supervisor.mode == mode
    assert supervisor.distrusted == ({JOINTS.index("RL_hip")} if mode else set())


def test_a_joint_that_stands_still_as_its_target_does_is_not_frozen(drive, description):
    q = description.poses["upright"]
    assert drive([{"q": q, "q_des": q + 0.002 * (tick % 2)} for tick in range(100)]).mode == SafetyMode.RUN


def test_as_much_as_the_target_of_a_resting_joint_moved_in_half_an_hour_of_standing_is_no_fault(drive, description):
    q = description.poses["upright"]  # 0.061 rad over 16 equal readings, in 90 000 simulated steps
    ticks = [{"q": q, "q_des": q + at("RL_hip", 0.061 * (tick % 2), 0.0)} for tick in range(100)]
    assert drive(ticks).mode == SafetyMode.RUN


def test_missing_readings_are_not_frozen_ones(drive, description):
    q = description.poses["upright"] + at("RL_hip", np.nan, 0.0)
    upright = description.poses["upright"]
    ticks = [{"q": q, "q_des": upright + at("RL_hip", 0.02 * tick, 0.0)} for tick in range(20)]
    assert drive(ticks).mode == SafetyMode.RUN


def test_a_joint_that_turns_faster_than_its_motor_can_makes_it_sit_down(drive):
    fast = {"dq": at("FL_knee", -27.0, 0.0)}
    assert drive([{}, fast, {}, fast]).mode == SafetyMode.RUN
    assert outcome(drive([{}, fast, fast])) == ("joint_impossible", SafetyMode.SIT_DOWN)


@pytest.mark.parametrize(("away", "mode"), [(0.7, SafetyMode.RUN), (0.9, SafetyMode.SIT_DOWN)])
def test_a_joint_that_does_not_get_to_its_target_makes_it_sit_down(away, mode, drive, description):
    q = description.poses["upright"]
    ticks = [{"q": q, "q_des": q + at("RR_knee", away, 0.0)} for _ in range(25)]
    assert drive(ticks[:24]).mode == SafetyMode.RUN
    assert drive(ticks).mode == mode


@pytest.mark.parametrize(
    ("health", "rule", "mode"),
    [
        ({"round_trip": 0.015}, None, SafetyMode.RUN),
        ({"round_trip": 0.03}, "answers_slow", SafetyMode.RUN),
        ({"round_trip": 0.062}, "answers_slow", SafetyMode.SIT_DOWN),
        ({"voltage": 22.0}, None, SafetyMode.RUN),
        ({"voltage": 20.0}, "battery_low", SafetyMode.RUN),
        ({"voltage": 18.5}, "battery_low", SafetyMode.SIT_DOWN),
    ],
)
def test_slow_answers_and_an_empty_battery_are_announced_and_then_end_the_run(health, rule, mode, drive):
    supervisor = drive([health] * 200)
    assert {event.rule for event in supervisor.events} == ({rule} if rule else set())
    assert supervisor.mode == mode


def test_a_moment_of_slow_answers_or_of_load_ends_nothing(drive):
    ticks = [{"round_trip": 0.003, "voltage": 24.0} for _ in range(300)]
    for tick in range(200, 210):
        ticks[tick] = {"round_trip": 0.2, "voltage": 15.0}
    assert not drive(ticks).events


# ---------------------------------------------------------------------- IMU


@pytest.mark.parametrize("age", [0.121, 1.0, np.inf])
def test_a_silent_imu_damps(age, drive):
    assert drive([{"imu_age": 0.11, "imu_count": 0}]).mode == SafetyMode.RUN
    silent = {"imu_age": age, "quat_WB": np.full(4, np.nan), "omega_B": np.full(3, np.nan)}
    assert outcome(drive([{}, silent])) == ("imu_silent", SafetyMode.DAMP)


def test_an_imu_that_repeats_itself_damps_within_four_readings(drive):
    same = {"quat_WB": UPRIGHT.as_quat(scalar_first=True), "omega_B": np.zeros(3)}
    assert drive([same] * 3).mode == SafetyMode.RUN
    assert outcome(drive([same] * 4)) == ("imu_silent", SafetyMode.DAMP)


def test_a_robot_that_lies_still_may_repeat_itself(drive):
    same = {"quat_WB": np.array([1.0, 0, 0, 0]), "omega_B": np.zeros(3)}
    assert drive([same] * 50, phase="lie").mode == SafetyMode.RUN


def test_one_reading_seen_twice_is_not_frozen(drive):
    same = {"quat_WB": UPRIGHT.as_quat(scalar_first=True), "omega_B": np.zeros(3), "imu_count": 7}
    assert drive([same] * 6).mode == SafetyMode.RUN


def test_an_imu_of_which_nothing_is_new_damps(drive):
    assert outcome(drive([{}, {"imu_unchanged": 0.13}])) == ("imu_silent", SafetyMode.DAMP)


def test_an_imu_that_calls_itself_invalid_damps_and_one_that_says_nothing_does_not(drive):
    assert drive([{"imu_valid": None}] * 3).mode == SafetyMode.RUN
    assert outcome(drive([{}, {"imu_valid": False}])) == ("imu_silent", SafetyMode.DAMP)


@pytest.mark.parametrize("axis", ["Y", "Z"])
@pytest.mark.parametrize("angle", [0.25, 1.0, 3.1])
def test_an_orientation_that_tilted_without_a_rate_of_turn_damps_in_three_ticks(axis, angle, drive):
    def turn(tick: int) -> Rotation:
        return UPRIGHT * Rotation.from_euler("Y", 0.001 * tick) * Rotation.from_euler(axis, angle if tick >= 2 else 0.0)

    assert drive([{}] * 4, turn=turn).mode == SafetyMode.RUN
    assert outcome(drive([{}] * 5, turn=turn)) == ("imu_contradiction", SafetyMode.DAMP)


@pytest.mark.parametrize("wrong", [{3}, {3, 4}, {3, 6, 7, 10}])
@pytest.mark.parametrize("angle", [0.4, 1.5, 3.1])
def test_a_forged_orientation_or_two_are_left_out(wrong, angle, drive):
    def turn(tick: int) -> Rotation:
        return UPRIGHT * Rotation.from_euler("Y", 0.001 * tick) * Rotation.from_euler("Z", angle * (tick in wrong))

    supervisor = drive([{}] * 12, turn=turn)
    assert supervisor.mode == SafetyMode.RUN
    assert [event.rule for event in supervisor.events] == ["imu_contradiction"]
    assert not supervisor.doubts_orientation


def test_an_orientation_that_is_left_out_is_marked(drive):
    turn = lambda tick: UPRIGHT * Rotation.from_euler("Z", 0.5 * (tick == 3))  # noqa: E731
    assert drive([{}] * 4, turn=turn).doubts_orientation
    assert not drive([{}] * 3, turn=turn).doubts_orientation


@pytest.mark.parametrize("angle", [0.2, np.pi / 2, -3.0])
def test_a_heading_that_the_imu_sets_anew_is_said_and_counted(angle, drive):
    supervisor = drive([{}] * 9, turn=lambda tick: Rotation.from_euler("z", angle * (tick >= 4)) * UPRIGHT)
    assert supervisor.mode == SafetyMode.RUN
    assert [event.rule for event in supervisor.events] == ["imu_contradiction"]
    assert f"jumped by {np.rad2deg(angle):.0f} deg" in supervisor.events[0].text
    assert supervisor.heading_jumps == pytest.approx(angle, abs=1e-6)


@pytest.mark.parametrize("late", [0.01, 0.02, 0.03])
def test_an_orientation_that_came_late_while_the_robot_turns_fast_ends_nothing(late, drive):
    rate, omega = 8.0, np.array([0.0, 8.0, 0.0])
    ticks = [{"omega_B": omega} for _ in range(10)]
    ticks[5]["imu_age"] = 0.0  # it came this moment, but was measured before

    def turn(tick: int) -> Rotation:
        return Rotation.from_euler("Y", rate * (DT * tick - late * (tick == 5)))

    assert drive(ticks, phase="stand_up", turn=turn).mode == SafetyMode.RUN


@pytest.mark.parametrize("axis", ["X", "Y", "Z"])
def test_an_orientation_that_turns_as_the_rate_says_is_believed(axis, drive):
    rate = 8.0  # healthy robots turn as fast as that while they stand up
    omega = rate * np.eye(3)["XYZ".index(axis)]
    supervisor = drive(
        [{"omega_B": omega}] * 5, phase="stand_up", turn=lambda tick: Rotation.from_euler(axis, rate * DT * tick)
    )
    assert not [e for e in supervisor.events if e.rule == "imu_contradiction"]


def test_an_imu_by_which_one_foot_is_in_the_ground_damps_in_three_ticks(drive):
    tilted = Rotation.from_euler("X", 0.4)  # a roll of the upright robot about the way it faces
    turn = lambda tick: tilted * UPRIGHT * Rotation.from_euler("Y", 0.001 * tick)  # noqa: E731
    assert drive([{}] * 2, turn=turn).mode == SafetyMode.RUN
    assert outcome(drive([{}] * 3, turn=turn)) == ("imu_contradiction", SafetyMode.DAMP)


def test_a_foot_lifted_for_two_ticks_is_no_contradiction(drive, description):
    lifted = description.poses["upright"].copy()
    lifted[JOINTS.index("RL_knee")] -= 0.6
    ticks = ([{}] * 3 + [{"q": lifted}] * 2) * 3
    assert drive(ticks).mode == SafetyMode.RUN


# ---------------------------------------------------------------------- falling


@pytest.mark.parametrize("axis", ["X", "Y"])
def test_a_robot_that_tips_over_while_it_should_stand_is_damped_within_a_tick(axis, drive):
    falls = [{"omega_B": np.eye(3)["XYZ".index(axis)] * -4.0}] * 12

    def turn(tick: int) -> Rotation:
        return UPRIGHT * Rotation.from_euler("Y", -0.08 * tick)

    omega = np.array([0.0, -4.0, 0.0])
    supervisor = drive([{"omega_B": omega}] * len(falls), turn=turn)
    assert outcome(supervisor) == ("falling", SafetyMode.DAMP)
    leaned = UPRIGHT.inv() * turn(round(supervisor.decisive.t / DT))
    assert np.arccos(LIMITS.upright) <= leaned.magnitude() <= np.arccos(LIMITS.upright) + 0.09


@pytest.mark.parametrize("phase", ["stand_up", "sit_down"])
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_robot_that_rolls_over_while_it_gets_up_or_down_is_damped(phase, side, drive):
    omega = np.array([side * 4.0, 0.0, 0.0])
    supervisor = drive([{"omega_B": omega}] * 14, phase=phase, turn=lambda n: Rotation.from_euler("X", side * 0.08 * n))
    assert outcome(supervisor) == ("falling", SafetyMode.DAMP)


def test_a_robot_that_falls_onto_its_back_while_it_gets_up_is_damped(drive):
    omega = np.array([0.0, -4.0, 0.0])
    supervisor = drive([{"omega_B": omega}] * 40, phase="stand_up", turn=lambda n: Rotation.from_euler("Y", -0.08 * n))
    assert outcome(supervisor) == ("falling", SafetyMode.DAMP)
    assert "back" in supervisor.decisive.text


# ---------------------------------------------------------------------- time, bus, guardian


def test_one_overrun_is_logged_and_three_in_a_row_damp(drive):
    supervisor = drive([{}, {"late": 0.012}, {}, {"late": 0.012}, {"late": 0.012}, {}])
    assert supervisor.mode == SafetyMode.RUN
    assert [e.rule for e in supervisor.events] == ["step_late"]
    assert outcome(drive([{"late": 0.011}] * 3)) == ("step_late", SafetyMode.DAMP)


def test_three_small_overruns_are_logged_and_half_a_second_of_them_damps(drive):
    assert not drive([{"late": 0.003}] * 2).events
    logged = drive([{"late": 0.003}] * 24)
    assert logged.mode == SafetyMode.RUN
    assert [e.rule for e in logged.events] == ["step_late"]
    assert outcome(drive([{"late": 0.003}] * 25)) == ("step_late", SafetyMode.DAMP)


def test_a_tenth_of_a_second_without_a_command_damps(drive):
    assert outcome(drive([{}, {"late": 0.11}])) == ("step_late", SafetyMode.DAMP)


def test_some_bus_errors_are_logged_and_a_burst_damps(drive):
    few = drive([{"bus_errors": n // 10} for n in range(100)])
    assert few.mode == SafetyMode.RUN
    assert [e.rule for e in few.events] == ["bus_errors"]
    assert outcome(drive([{"bus_errors": 4 * n} for n in range(5)])) == ("bus_errors", SafetyMode.DAMP)


def test_after_a_pause_of_the_process_that_sends_it_sits_down(drive):
    assert drive([{}, {"sender_age": 0.05}]).mode == SafetyMode.RUN
    assert outcome(drive([{}, {"sender_age": 0.08}])) == ("sender", SafetyMode.SIT_DOWN)


# ---------------------------------------------------------------------- what holds for all of them


def test_a_decision_is_never_revoked(drive):
    supervisor = drive([{"imu_valid": False}])
    drive([{}] * 5, supervisor=supervisor, first=1)
    assert supervisor.mode == SafetyMode.DAMP


def test_a_damped_robot_is_stopped_once_it_has_rested(drive):
    supervisor = drive([{"terminated": True}])
    moving = {"phase": "damp", "dq": np.full(12, 0.3)}
    drive([moving] * 50, supervisor=supervisor, first=1)
    assert supervisor.mode == SafetyMode.DAMP
    drive([{"phase": "damp"}] * 24, supervisor=supervisor, first=51)
    assert supervisor.mode == SafetyMode.DAMP
    drive([{"phase": "damp"}] * 3, supervisor=supervisor, first=75)
    assert supervisor.mode == SafetyMode.STOPPED


@pytest.mark.parametrize("dq", [0.5, np.nan])
def test_a_damped_robot_that_never_rests_or_is_never_heard_is_stopped_in_time(dq, drive):
    supervisor = drive([{"terminated": True}])
    ticks = round(LIMITS.damp_seconds / DT)
    moving = {"phase": "damp", "dq": np.full(12, dq)}
    drive([moving] * (ticks - 2), supervisor=supervisor, first=1)
    assert supervisor.mode == SafetyMode.DAMP
    drive([moving] * 4, supervisor=supervisor, first=ticks - 1)
    assert supervisor.mode == SafetyMode.STOPPED


def test_every_rule_has_a_name_of_its_own():
    names = [rule.name for rule in RULES]
    assert len(set(names)) == len(names)
    assert FAILURE not in names
    assert len(names) <= 15


@pytest.mark.parametrize("name", sorted(set(LIMITS.__dataclass_fields__)))
def test_every_limit_is_positive_but_for_the_one_that_looks_down(name):
    assert (getattr(LIMITS, name) > 0) is (name != "backward")
