"""Several logs of one machine: what each says of itself acts on it alone, and contradictions are refused."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from mimic.config.sysid import LogSettings
from mimic.dynamics.effect_set import EffectSet, EffectValues
from mimic.dynamics.machine import MachineModel, read_machine, with_gains
from mimic.errors import CalibrationError
from mimic.io.joint_log import JointLog
from mimic.sysid.engine.data import data_of
from mimic.sysid.engine.likelihood import FOLLOWING
from mimic.sysid.engine.model import setting_of
from mimic.sysid.log.pool import missing, pool
from mimic.sysid.predict import predict, simulate_log

PENDULUM = """<mujoco><worldbody><body><joint name="hinge" axis="0 1 0" damping="0.05" frictionloss="0.05"/>
<inertial pos="0 0 -0.1" mass="0.2" diaginertia="0.004 0.004 0.0001"/><site pos="0 0 -0.15"/></body></worldbody>
</mujoco>"""
QUIET: dict[str, Any] = {"noise": 0.0, "resolution": 0.0, "torque_noise": 0.0, "timestep": 0.0005}


@pytest.fixture(scope="module")
def pendulum(tmp_path_factory: pytest.TempPathFactory) -> MachineModel:
    path = tmp_path_factory.mktemp("pendulum") / "pendulum.xml"
    path.write_text(PENDULUM)
    return read_machine(path, {"kp": 20.0, "kd": 0.8})


def swung(machine: MachineModel, seconds: float = 6.0, payload: float = 0.0, **notes: Any) -> JointLog:
    """Return a log without noise of a pendulum with a payload at its end and gains of its own."""
    t = np.arange(0.0, seconds, 0.02)
    q_des = 0.5 * np.sin(5.0 * t[:, None]) + 0.2 * np.sign(np.sin(9.0 * t[:, None]))
    load = EffectValues(name="payload", joints=("hinge",), values={"mass": np.array([payload])})
    log = simulate_log(with_gains(machine, notes), t, q_des, EffectSet((load,)), LogSettings(**QUIET))
    return replace(log, tau=None, metadata={**log.metadata, **({"payload": payload} if payload else {})})


def left(logs: list[JointLog], machine: MachineModel) -> np.ndarray:
    """Return what the machine as given leaves of each log [rad]."""
    data = data_of(logs, machine)
    setting = setting_of(data)
    (e,) = setting.passes.run([setting.blank], setting.gains.of(FOLLOWING * setting.gains.torque, setting.data))
    return np.array([np.sqrt(np.mean(e[data.counts[:, 0] & (data.record.log == k)] ** 2)) for k in range(data.logs)])


def test_each_log_is_replayed_with_its_own_gains_and_payload(pendulum: MachineModel) -> None:
    logs = [swung(pendulum, kp=20.0, kd=0.8), swung(pendulum, 5.4, kp=9.0, kd=0.4), swung(pendulum, payload=0.15)]
    assert np.all(left(logs, pendulum) < 2e-4)
    for wrong in ({"kp": 20.0}, {"payload": 0.1}):
        worse = [logs[0], *(replace(log, metadata={**log.metadata, **wrong}) for log in logs[1:])]
        assert left(worse, pendulum)[1:].max() > 2e-3


def test_a_log_without_feed_forward_beside_one_with_it_has_none(pendulum: MachineModel) -> None:
    """A force acts like a shift of the target by it over Kp."""
    log = swung(pendulum)
    shift = 0.1 * np.sign(np.sin(3.0 * log.t[:, None]))
    assert log.q_des is not None
    pushed = replace(log, q_des=log.q_des - shift, force=20.0 * shift)
    assert np.all(left([log, pushed], pendulum) < 2e-4)
    assert np.all(left([pushed, log], pendulum) < 2e-4)
    assert left([log, replace(pushed, force=None)], pendulum)[1] > 0.02


def test_a_drive_that_is_switched_off_lets_its_joint_fall(pendulum: MachineModel) -> None:
    """The closed form: a pendulum without friction that is let go swings back to the height it came from."""
    free = replace(pendulum, drives=replace(pendulum.drives, friction=np.zeros(1)))
    t = np.arange(0.0, 6.0, 0.005)
    on = t < 2.0
    inertia, moment = 0.004 + 0.2 * 0.1**2, 0.2 * 9.81 * 0.1
    q, v, path = 0.8, 0.0, []
    for time in np.arange(0.0, 6.0, 0.0001):
        held = time < 2.0
        v += 0.0001 * (0.0 if held else -moment * np.sin(q) / inertia)
        q += 0.0001 * v
        path.append(0.8 if held else q)
    log = JointLog(
        joints=("hinge",),
        t=t,
        q=np.array(path)[::50, None],
        q_des=np.where(on, 0.8 + moment * np.sin(0.8) / 20.0, 0.3)[:, None],
        extra={"enabled": on.astype(float)},
        metadata={"kp": 20.0, "kd": 0.8, "sent": "row"},
    )
    none = {"coulomb": "level", "viscous": "coefficient"}
    smooth = EffectSet(tuple(EffectValues(name=n, joints=("hinge",), values={p: np.zeros(1)}) for n, p in none.items()))
    assert np.nanmax(np.abs(predict(log, free, smooth, whole=True))) < 0.02
    on_all_along = replace(log, extra={})
    assert np.nanmax(np.abs(predict(on_all_along, free, smooth, whole=True))) > 0.5


def test_a_lower_supply_moves_the_torque_speed_line(pendulum: MachineModel) -> None:
    fast = replace(pendulum, drives=replace(pendulum.drives, torque=np.ones(1), flat=np.ones(1), speed=np.full(1, 4.0)))
    t = np.arange(0.0, 6.0, 0.02)
    q_des = 1.2 * np.sign(np.sin(5.0 * t[:, None]))
    weak = replace(fast, drives=replace(fast.drives, torque=np.ones(1), flat=np.zeros(1), speed=np.full(1, 3.0)))
    # 1 N m to 1 rad/s and none at 4 is 4/3 N m at rest; three quarters of it are 1 N m, and none at 3 rad/s
    logs = [replace(simulate_log(m, t, q_des, EffectSet(()), LogSettings(**QUIET)), tau=None) for m in (fast, weak)]
    logs = [replace(log, metadata={**log.metadata, "voltage": v}) for log, v in zip(logs, (12.0, 9.0), strict=True)]
    assert np.all(left(logs, fast) < 3e-4)
    same = [replace(log, metadata={**log.metadata, "voltage": 12.0}) for log in logs]
    assert left(same, fast)[1] > 5e-3


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"metadata": {"kp": 20.0, "sent": "row"}}, r"a\.parquet says its kd, but b\.csv does not"),
        ({"joints": ("knee",)}, r"a\.parquet has joints hinge, but b\.csv has knee"),
        ({"q_des": None, "force": 0.0}, r"a\.parquet has targets \(q_des\), but b\.csv has none"),
        ({"metadata": {"kp": 20.0, "kd": 0.8, "gravity": [0, 0, -1]}}, r"a\.parquet and b\.csv have different gravity"),
        (
            {"metadata": {"kp": 20.0, "kd": 0.8, "payload": {"knee": 1}}},
            r"b\.csv: payload at 'knee'; the joints are",
        ),
        ({"metadata": {"kp": 20.0, "kd": 0.8, "payload": -1.0}}, r"b\.csv: the payload at hinge is -1\.0; expected"),
    ],
)
def test_logs_that_contradict_each_other_are_refused_with_both_names(
    pendulum: MachineModel, changed: dict[str, Any], message: str
) -> None:
    log = swung(pendulum)
    changed = dict(changed)
    if "force" in changed:
        changed["force"] = np.zeros_like(log.q)
    other = replace(log, **changed)
    with pytest.raises(CalibrationError, match=message):
        pool([log, other], pendulum, ("a.parquet", "b.csv"))


def test_a_row_without_a_torque_is_missing_as_one_without_a_position_is():
    zeros = np.zeros((4, 1))
    log = JointLog(joints=("hinge",), t=np.arange(4) / 100, q=zeros, q_des=zeros, tau=zeros)
    gap = np.array([[0.0], [np.nan], [0.0], [0.0]])
    assert missing(replace(log, tau=gap, q=np.roll(gap, 1))).tolist() == [False, True, True, False]
