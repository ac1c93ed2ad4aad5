"""The torque screen on a pendulum that is simulated here, step by step, and on a measured machine."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mimic.dynamics.catalogue import CATALOGUE
from mimic.dynamics.machine import MachineModel, read_machine
from mimic.errors import CalibrationError
from mimic.io.joint_log import JointLog
from mimic.sysid.log.timing import at_rows
from mimic.sysid.torque.regression import Torques, asked_for, torques_of

MASS, LENGTH, ROTOR, DRY, VISCOUS, DELAY = 0.8, 0.15, 0.004, 0.12, 0.03, 0.006
STEP, RATE = 2e-4, 200.0

MJCF = f"""<mujoco><worldbody><body pos="0 0 1"><joint name="j" axis="0 1 0" armature="{ROTOR}"/>
<inertial pos="0 0 -{LENGTH}" mass="{MASS * 1.05}" diaginertia="1e-4 1e-4 1e-4"/></body></worldbody></mujoco>"""


def pendulum(seconds: float = 24.0, kp: float = 30.0, seed: int = 0, load: float = 0.0, drag: float = 0.0) -> JointLog:
    """Return a log of a pendulum with a position drive: sines, and slow triangles in the last third."""
    rng = np.random.default_rng(seed)
    t_send = np.arange(0.0, seconds, 0.02)
    phase = rng.uniform(0, 2 * np.pi, 4)
    fast = sum(0.5 / (1 + k) * np.sin(2 * np.pi * f * t_send + phase[k]) for k, f in enumerate((0.3, 0.8, 1.7, 3.1)))
    slow = 1.6 * np.abs((0.4 * t_send + phase[0]) % 2.0 - 1.0) - 0.8
    goals = np.where(t_send < seconds * 2 / 3, fast, slow)
    inertia = MASS * LENGTH**2 + 1e-4 + ROTOR
    q, v, rows = goals[0], 0.0, []
    for i in range(round(seconds / STEP)):
        t = i * STEP
        if i % round(1 / RATE / STEP) == 0:
            rows.append((t, q, goals[min(int(t / 0.02 + 1e-6), len(goals) - 1)]))
        goal = goals[min(max(int((t - DELAY) / 0.02 + 1e-6), 0), len(goals) - 1)]
        tau = kp * (goal - q) - 0.8 * v
        free = v + STEP * (tau - VISCOUS * v - drag * v * abs(v) - MASS * 9.81 * LENGTH * math.sin(q)) / inertia
        brake = STEP * (DRY + load * abs(tau)) / inertia
        v = math.copysign(max(abs(free) - brake, 0.0), free)
        q += STEP * v
    t, position, target = np.array(rows).T
    reading = position + 3e-4 * rng.standard_normal(len(t))
    return JointLog(joints=("j",), t=t, q=reading[:, None], q_des=target[:, None], metadata={"kp": kp, "kd": 0.8})


@pytest.fixture(scope="module")
def machine(tmp_path_factory: pytest.TempPathFactory) -> MachineModel:
    """Return the pendulum as its maker gives it, with 5 % too much mass."""
    path = tmp_path_factory.mktemp("screen") / "pendulum.xml"
    path.write_text(MJCF, encoding="utf-8")
    return read_machine(path)


def test_little_is_left_of_a_machine_without_hidden_effects(machine: MachineModel) -> None:
    made = Torques([(pendulum(), machine)])
    assert made.delay == pytest.approx(DELAY, abs=1e-3)
    assert made.regression.spread < 0.03 * made.regression.torque


def test_load_friction_is_first_with_its_size(machine: MachineModel) -> None:
    best = Torques([(pendulum(load=0.15), machine)]).singles()[0]
    assert best.names == ("load_friction",)
    assert best.coefficients[0][0] == pytest.approx(0.15, rel=0.15)


def test_what_is_given_leaves_the_other_effect(machine: MachineModel) -> None:
    torques = Torques([(pendulum(load=0.15, drag=0.06), machine)])
    first = torques.singles(("load_friction", "quadratic_drag", "spring"))[0]
    (other,) = {"load_friction", "quadratic_drag"} - set(first.names)
    assert torques.singles(("load_friction", "quadratic_drag", "spring"), given=first.names)[0].names == (other,)


def test_short_logs_with_other_gains_are_pooled(machine: MachineModel) -> None:
    logs = [(pendulum(8.0, kp=kp, seed=k, load=0.15), machine) for k, kp in enumerate((15.0, 30.0, 50.0))]
    made, alone = (Torques(some).singles() for some in (logs, logs[:1]))
    assert made[0].names == ("load_friction",)
    assert made[0].z > alone[0].z


def test_only_named_effects_are_tried(machine: MachineModel) -> None:
    made = Torques([(pendulum(8.0, load=0.15), machine)]).singles(("spring", "stribeck"))
    assert {s.names[0] for s in made} == {"spring", "stribeck"}


def test_a_shortlist_has_what_is_hidden_first_and_what_torques_cannot_judge(machine: MachineModel) -> None:
    every = [name for name, e in CATALOGUE.items() if not e.baseline]
    kept = asked_for(torques_of([(pendulum(12.0, load=0.15), machine)]), every)
    assert kept[0] == "load_friction"
    assert {"gains", "kt_gain", "delay_jitter", "lost_commands", "encoder_step"} <= set(kept) < set(every)


def test_rows_that_may_not_be_looked_at_change_nothing(machine: MachineModel) -> None:
    log = pendulum(16.0, load=0.15)
    rows = log.t < 12.0
    q = np.where(log.t[:, None] > 13.0, log.q * 0.7 + 0.2 * np.sin(9 * log.t)[:, None], log.q)
    other = JointLog(joints=log.joints, t=log.t, q=q, q_des=log.q_des, metadata=log.metadata)
    made, again = (Torques([(x, machine)], rows=[rows]) for x in (log, other))
    assert made.singles()[0].names == again.singles()[0].names == ("load_friction",)
    left = [t.regression.spread for t in (made, again, Torques([(other, machine)]))]
    assert left[1] == pytest.approx(left[0], rel=0.02)
    assert left[2] > 2 * left[0]


def test_where_nothing_can_be_judged_there_are_no_torques(machine: MachineModel) -> None:
    log = pendulum(2.0)
    still = JointLog(joints=log.joints, t=log.t, q=log.q * 0, q_des=log.q_des, metadata=log.metadata)
    assert torques_of([(still, machine)]) == ()


def test_targets_are_those_of_the_times_at_which_they_were_sent(machine: MachineModel) -> None:
    """Rows beside the clock of the targets show each up to a row late, now more and now less."""
    log = pendulum(16.0)
    sent = replace(at_rows(log), at=np.arange(len(at_rows(log).at)) * 0.02)
    late = replace(log, t=log.t + 0.0, q_des=np.concatenate([log.q_des[:1], log.q_des[:-1]]))
    known = replace(sent, rows=at_rows(late).rows, at=sent.at[: len(at_rows(late).rows)])
    right, shown = (Torques([(late, machine)], sending=x) for x in ([known], None))
    assert right.delay == pytest.approx(DELAY, abs=1e-3)
    assert shown.delay == pytest.approx(DELAY - 0.005, abs=1e-3)


def test_a_joint_at_rest_is_refused_with_what_to_do(machine: MachineModel) -> None:
    log = pendulum(4.0)
    still = JointLog(joints=log.joints, t=log.t, q=log.q * 0, q_des=log.q_des, metadata=log.metadata)
    with pytest.raises(CalibrationError, match="log more motion"):
        Torques([(still, machine)])


@pytest.mark.slow
@pytest.mark.skipif(not Path("../shared/data/logs/emps").exists(), reason="needs the EMPS data")
def test_asymmetric_friction_of_a_worn_screw_is_first(tmp_path: Path) -> None:
    from lab.real_logs.logs import ASYMMETRIC, EMPS_MJCF, emps_log, identify, read_emps

    columns = read_emps(Path("../shared/data/logs/emps/DATA_EMPS.parquet"))
    (tmp_path / "emps.xml").write_text(EMPS_MJCF, encoding="utf-8")
    best = Torques([(emps_log(columns, identify(columns)), read_machine(tmp_path / "emps.xml"))]).singles()[0]
    assert best.names == ("asymmetric_friction",)
    forward, backward = ASYMMETRIC["viscous"]
    assert -best.coefficients[0][1] == pytest.approx((backward - forward) / 2, rel=0.05)
