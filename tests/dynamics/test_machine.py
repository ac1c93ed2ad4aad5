from copy import copy
from pathlib import Path

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mimic.dynamics.machine import MachineModel, as_logged, change_links, hung_robot, read_machine, tilted_gravity
from mimic.dynamics.servo import static_model
from mimic.errors import AssetError
from mimic.records import JOINTS

SLIDE = """<mujoco><worldbody><body name="cart"><inertial pos="0 0 0" mass="2" diaginertia="1 1 1"/>
<joint name="{joint}" type="{type}" axis="1 0 0" frictionloss="3"/></body></worldbody></mujoco>"""


def written(folder: Path, joint: str = "slide", type: str = "slide") -> Path:
    path = folder / "robot.xml"
    path.write_text(SLIDE.format(joint=joint, type=type))
    return path


def test_a_sliding_joint_is_read_in_metres_with_its_friction(tmp_path: Path) -> None:
    machine = read_machine(written(tmp_path), {"kp": 100.0, "kd": {"slide": 5.0}})
    assert machine.unit == "m"
    assert (machine.drives.kp[0], machine.drives.kd[0], machine.drives.friction[0]) == (100.0, 5.0, 3.0)


def test_a_free_base_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "robot.xml"
    path.write_text(
        SLIDE.format(joint="base", type="slide").replace('type="slide" axis="1 0 0" frictionloss="3"', 'type="free"')
    )
    with pytest.raises(AssetError, match="'base' is free or a ball"):
        read_machine(path)


def test_a_file_that_is_no_model_is_refused(tmp_path: Path) -> None:
    (tmp_path / "robot.xml").write_text("<mujoco>")
    with pytest.raises(AssetError, match="not an MJCF"):
        read_machine(tmp_path / "robot.xml")


ARM = """<mujoco><option gravity="0 0 -9.81"/><worldbody><body name="base" {turn}>
<body name="upper" pos="0.1 0 0">
<inertial pos="0.02 0.01 -0.1" mass="0.6" fullinertia="0.003 0.004 0.002 0.0004 0.0003 -0.0002"/>
<joint name="shoulder" axis="0 1 0"/>
<body name="lower" pos="0 0 -0.2">
<inertial pos="0 0.01 -0.08" quat="0.9 0.3 0.2 0.1" mass="0.3" diaginertia="0.002 0.0015 0.0007"/>
<joint name="elbow" axis="0 1 0"/><site name="hand" pos="0 0 -0.18"/>{load}</body></body>
<body name="other" pos="0 1 0"><inertial pos="0 0 -0.1" mass="0.2" diaginertia="0.001 0.001 0.001"/>
<joint name="alone" axis="1 0 0"/></body></body></worldbody></mujoco>"""


def arm(folder: Path, turn: str = "", load: str = "") -> MachineModel:
    (folder / "arm.xml").write_text(ARM.format(turn=turn, load=load))
    return read_machine(folder / "arm.xml")


def static(machine: MachineModel, q: np.ndarray, gravity: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Return inertia matrix and gravity torques at joint positions q."""
    model = machine.model
    if gravity is not None:
        model.opt.gravity[:] = gravity
    data = mujoco.MjData(model)
    data.qpos[:] = q
    mujoco.mj_forward(model, data)
    full = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, full)
    return full, data.qfrc_bias.copy()


def test_a_payload_is_the_body_that_mujoco_would_compose(tmp_path: Path) -> None:
    ball = '<body pos="0 0 -0.18"><inertial pos="0 0 0" mass="0.25" diaginertia="1e-12 1e-12 1e-12"/></body>'
    loaded, bare = arm(tmp_path, load=ball), arm(tmp_path)
    static_model(bare.model, bare, {("payload", "mass"): np.array([[0.0, 0.25, 0.0]])})
    for q in np.random.default_rng(0).uniform(-2, 2, (5, 3)):
        for one, other in zip(static(bare, q), static(loaded, q), strict=True):
            assert one == pytest.approx(other, abs=1e-9)


def test_a_tilted_base_is_a_model_that_is_turned(tmp_path: Path) -> None:
    roll, pitch = 0.3, -0.2
    turn = Rotation.from_euler("y", pitch) * Rotation.from_euler("x", roll)
    w, x, y, z = turn.as_quat(scalar_first=True)
    turned, level = arm(tmp_path, turn=f'quat="{w} {x} {y} {z}"'), arm(tmp_path)
    gravity = tilted_gravity(roll, pitch)
    q = np.array([0.4, -0.7, 0.9])
    assert static(level, q, gravity)[1] == pytest.approx(static(turned, q)[1], abs=1e-9)


def test_masses_and_centres_of_links_change(tmp_path: Path) -> None:
    machine = arm(tmp_path)
    made = copy(machine.model)
    change_links(made, machine.body, machine, np.array([2.0, 1.0, 0.5]), np.array([0.0, 0.03, 0.0]), np.zeros(3))
    upper, lower, other = machine.body
    assert made.body_mass[[upper, lower, other]] == pytest.approx([1.2, 0.3, 0.1])
    assert made.body_inertia[upper] == pytest.approx(2 * machine.model.body_inertia[upper])
    assert made.body_ipos[lower] - machine.model.body_ipos[lower] == pytest.approx([0.0, 0.0, -0.03])
    assert machine.model.body_mass[upper] == pytest.approx(0.6), "the model stays as it was"


def test_joints_belong_to_the_chain_of_links_that_they_move(tmp_path: Path) -> None:
    machine = arm(tmp_path)
    assert machine.joints == ("shoulder", "elbow", "alone")
    assert machine.chain.tolist() == [0, 0, 1]
    assert machine.place.tolist() == [0, 1, 0]
    assert machine.last.tolist() == [False, True, True]
    assert np.asarray(machine.drives.neighbour).tolist() == [1, 0, 2]


def test_the_suspended_robot_is_four_legs_with_toes_at_their_ends(description) -> None:
    machine = hung_robot(description)
    assert machine.joints == JOINTS
    assert machine.chain.tolist() == [leg for leg in range(4) for _ in range(3)]
    knees = np.flatnonzero(machine.last)
    assert [JOINTS[i][3:] for i in knees] == ["knee"] * 4
    assert machine.tip[knees[0]] == pytest.approx(description.leg.toe, abs=1e-6)
    assert (machine.low, machine.high) == (
        pytest.approx(description.q_min, abs=1e-3),
        pytest.approx(description.q_max, abs=1e-3),
    )


ONE = """<mujoco><worldbody><body><joint name="a" axis="0 1 0"{joint}/><geom size="0.1"/>
<body pos="0 0 -1"><joint name="b" axis="0 1 0"/><geom size="0.1"/></body></body></worldbody>{more}</mujoco>"""


@pytest.mark.parametrize(
    ("joint", "actuators", "kp", "kd", "torque"),
    [
        ("", '<position joint="a" kp="50" kv="2" forcerange="-4 4"/>', 50.0, 2.0, 4.0),
        ("", '<position joint="a" kp="50"/><velocity joint="a" kv="3"/>', 50.0, 3.0, np.inf),
        ("", '<position joint="a" kp="50" kv="2" gear="3" forcerange="-4 4"/>', 450.0, 18.0, 12.0),
        (' actuatorfrcrange="-5 5"', '<position joint="a" kp="50"/>', 50.0, 0.0, 5.0),
        ("", '<motor joint="a" forcerange="-7 7"/>', 0.0, 0.0, 7.0),
        ("", "", 0.0, 0.0, np.inf),
    ],
)
def test_actuators_are_read_as_they_act_on_the_joint(tmp_path: Path, joint, actuators, kp, kd, torque) -> None:
    path = tmp_path / "robot.xml"
    path.write_text(ONE.format(joint=joint, more=f"<actuator>{actuators}</actuator>" if actuators else ""))
    drives = read_machine(path).drives
    assert (drives.kp[0], drives.kd[0]) == pytest.approx((kp, kd))
    assert drives.torque[0] == pytest.approx(torque) if np.isfinite(torque) else drives.torque[0] >= 1e6
    assert (drives.kp[1], drives.kd[1]) == (0.0, 0.0)
    assert drives.torque[1] >= 1e6


def test_joints_that_are_tied_to_each_other_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "robot.xml"
    path.write_text(ONE.format(joint="", more='<equality><joint joint1="a" joint2="b"/></equality>'))
    with pytest.raises(AssetError, match="elements of equality"):
        read_machine(path)


def test_the_notes_of_a_log_tell_gains_and_gravity(tmp_path: Path) -> None:
    machine = arm(tmp_path)
    notes = {"kp": 7.0, "gravity": [0.0, 9.81, 0.0]}
    noted = as_logged(machine, notes)
    assert noted.model.opt.gravity == pytest.approx([0.0, 9.81, 0.0])
    assert machine.model.opt.gravity == pytest.approx([0.0, 0.0, -9.81])
    assert np.all(np.asarray(noted.drives.kp) == 7.0)
    assert np.all(np.asarray(as_logged(machine, notes, by_force=True).drives.kp) == 0.0)
