"""mimic on Unitree's own simulator, where its files are."""

from __future__ import annotations

import numpy as np
import pytest

from lab.in_process.sender_link import EmulatedSenderLink
from lab.unitree_mujoco.__main__ import checksum, network, starts, wiring_file
from lab.unitree_mujoco.bridge import LockstepBus, NotHere, load
from mimic.errors import AssetError
from mimic.hardware.go2.driver import Go2Driver
from mimic.hardware.go2.wiring import load_go2
from mimic.hardware.robot.plant import Robot
from mimic.records import JOINTS, JointCommand
from mimic.robot.description import load_description

pytestmark = pytest.mark.slow


@pytest.fixture(autouse=True)
def here():
    try:
        load()
    except NotHere as reason:
        pytest.skip(str(reason))


def test_messages_have_the_bytes_and_checksums_of_unitrees_sdk():
    assert checksum() == 0


def test_a_robot_in_unitrees_model_goes_joint_by_joint_where_it_is_told(tmp_path):
    d = load_description("go2")
    bus, zeros = LockstepBus(d, 0), np.zeros(12)
    link = EmulatedSenderLink(Go2Driver(bus, load_go2(wiring_file(tmp_path)), d), d)
    assert bus.data.qpos[2] < 0.1  # it sank without power
    bus.listen(0.5)
    robot = Robot(link, d)
    robot.start()
    four = JointCommand(q_des=d.poses["four"], dq_des=zeros, kp=np.full(12, 60.0), kd=np.full(12, 2.0), tau_ff=zeros)
    for _ in range(75):
        tick = robot.step(four)
    away = np.abs(tick.state.q - d.poses["four"])
    assert away.max() < 0.25, dict(zip(JOINTS, away.round(2), strict=True))
    assert bus.data.qpos[2] > 0.25
    robot.close()
    assert max(one.kp for one in bus.last.motor_cmd) == 0.0


def test_a_second_writer_of_unitrees_sdk_is_refused():
    found = network()
    assert found["alone"]["status"] == 0
    assert found["beside another program"]["status"] == 2
    assert any("commands came; who may send: python" in line for line in found["beside another program"]["said"])


def test_a_robot_stands_up_boxes_rides_out_lost_messages_and_sits_down():
    try:
        (row,) = starts(1, [])
    except AssetError as reason:
        pytest.skip(str(reason))
    assert row["stood"]
    assert row["lies"]
    assert row["damped_last"]
    assert row["rules"] == []
