"""The emulated stock board: the firmware's rules, in the figures that were measured on the maker's firmware."""

from __future__ import annotations

import numpy as np
import pytest

from mimic.config.emulator import EmulateSettings
from mimic.emulator.boards.board import EmulatedBoard
from mimic.emulator.boards.board_base import TICK
from mimic.emulator.faults import parse_fault
from mimic.errors import ConfigError
from mimic.hardware.stock.messages import MOTOR_CTRL, MOTOR_ERRORS, TYPES
from mimic.hardware.stock.wiring import load_board
from mimic.robot.description import load_description

D, WIRING = load_description("cyberdog2"), load_board()

SUSPENDED = EmulateSettings(suspended=True, placement=0.0, imu_noise=0.0)

ZERO = MOTOR_CTRL.encode()


class Client:
    """Speaks to a board, a message each cycle, and remembers what it says."""

    def __init__(self, *faults: str, settings: EmulateSettings = SUSPENDED) -> None:
        self.board = EmulatedBoard(D, WIRING, settings, faults=[parse_fault(text) for text in faults])
        self.last: dict = {}
        self.count: dict[str, int] = {}
        self.flags: list[tuple[float, int]] = []

    def run(self, seconds: float, data: bytes | None = None) -> None:
        for _ in range(round(seconds / TICK)):
            if data is not None:
                self.board.take(MOTOR_CTRL.channel, data, self.board.now + TICK / 2)
            self.board.advance(self.board.now + TICK)
            for message in self.board.published(self.board.now):
                fields = self.last[message.channel] = TYPES[message.channel].decode(message.data)
                self.count[message.channel] = self.count.get(message.channel, 0) + 1
                if message.channel == "motor_ctrl_state" and (
                    not self.flags or self.flags[-1][1] != int(fields["err_flag"])
                ):
                    self.flags.append((message.t, int(fields["err_flag"])))

    @property
    def err(self) -> int:
        return int(self.last["motor_ctrl_state"]["err_flag"])

    def q(self) -> np.ndarray:
        """Return the joints' angles (12,), in the firmware's order and sign."""
        spi = self.last["spi_data"]
        return np.stack([spi[f"q_{part}"] for part in ("abad", "hip", "knee")], axis=1).reshape(12)

    def tau(self) -> np.ndarray:
        spi = self.last["spi_data"]
        return np.stack([spi[f"tau_{part}"] for part in ("abad", "hip", "knee")], axis=1).reshape(12)


def ready(*faults: str, **more) -> Client:
    """Return a client whose board has left error 0x02."""
    client = Client(*faults, **more)
    client.run(0.1)
    client.run(2.6, ZERO)
    assert not client.err & 0x02
    return client


def holding(client: Client, kp=20.0, kd=1.0, **more) -> bytes:
    values = {"q_des": client.q(), "kp_des": [kp] * 12, "kd_des": [kd] * 12, **more}
    return MOTOR_CTRL.encode(**values)


def test_before_the_first_command_it_sends_joints_and_orientation_at_50_hz_and_nothing_else():
    client = Client()
    client.run(1.0)
    assert client.count == {"leg_control_data": 50, "state_estimator": 50}


def test_from_the_first_command_on_all_four_come_every_cycle():
    client = Client()
    client.run(0.1)
    before = dict(client.count)
    client.run(1.0, ZERO)
    rates = {name: client.count[name] - before.get(name, 0) for name in client.count}
    assert rates["leg_control_data"] == rates["state_estimator"] == rates["spi_data"] == 500
    assert rates["motor_ctrl_state"] == 498  # the first one 5 ms after the first command


def test_it_begins_in_error_2_which_zero_messages_clear_after_2_5_seconds():
    client = Client()
    client.run(2.6, ZERO)
    (begin, first), *_ = client.flags
    cleared = next(t for t, flag in client.flags if not flag & 0x02)
    assert first & 0x02
    assert cleared - begin == pytest.approx(2.498, abs=1e-6)  # 1250 cycles, the first and the last included


@pytest.mark.slow
def test_messages_that_are_not_zero_never_clear_error_2():
    client = Client()
    client.run(0.01, ZERO)
    client.run(4.0, MOTOR_CTRL.encode(kp_des=[1.0] * 12))
    assert client.err & 0x02
    client.run(2 * TICK, ZERO)
    assert not client.err & 0x02


def test_a_gap_of_10_ms_is_an_error_until_the_next_command_and_scales_velocity_and_torque():
    client = ready()
    push = [0.0] * 12
    push[1] = 2.0  # FR hip
    client.run(0.02, MOTOR_CTRL.encode(tau_des=push))
    assert client.tau()[1] == pytest.approx(2.0, abs=1e-3)
    client.run(0.008)
    assert not client.err & 0x01
    client.run(0.014)
    assert client.err & 0x01
    gap = float(client.last["motor_ctrl_state"]["ctrl_topic_interval"])
    client.run(TICK)  # the torque of a cycle is in the readings of the next one
    assert client.tau()[1] == pytest.approx(2.0 * 10.0 / gap, abs=0.01)
    client.run(TICK, ZERO)
    assert not client.err & 0x01


@pytest.mark.slow
def test_after_500_ms_of_silence_it_damps_for_2_5_seconds_and_then_lets_go():
    client = ready()
    client.run(0.1, holding(client))
    client.run(0.496)
    assert not client.err & 0x02
    client.run(0.006)
    assert client.err & 0x03 == 0x03
    begin = client.flags[-1][0]
    assert client.board.applied[3][[1, 2, 4, 5]].tolist() == [4.0] * 4  # an abad hangs at its soft stop
    while client.board.now < begin + 2.494:
        client.run(TICK)
    assert client.board.applied[3][[1, 2, 4, 5]].tolist() == [4.0] * 4  # an abad hangs at its soft stop
    client.run(0.008)
    assert not client.board.applied[3].any()


@pytest.mark.slow
def test_desired_positions_are_cut_on_every_leg_but_shown_for_the_last_one_only():
    client = ready()
    client.run(0.05, holding(client))
    for joint in range(12):
        degrees, bit = ((8.0, 0x4), (10.0, 0x8), (12.0, 0x10))[joint % 3]
        client.run(0.3, MOTOR_CTRL.encode(kd_des=[4.0] * 12))
        q = client.q()
        q_des = q.copy()
        q_des[joint] -= np.copysign(0.25, q[joint])  # away from the joint's stop
        client.run(TICK, MOTOR_CTRL.encode(q_des=q_des, kp_des=[60.0] * 12))
        cut = abs(client.board.applied[0][joint] - q[joint])
        assert cut == pytest.approx(np.deg2rad(degrees), abs=2e-3)
        assert bool(client.err & bit) == (joint >= 9)


def test_desired_positions_stay_inside_the_joint_limits():
    client = ready()
    q_des = client.q()
    q_des[2] = 3.0  # FR knee; its stop is at 2.53
    client.run(TICK, MOTOR_CTRL.encode(q_des=q_des, kp_des=[60.0] * 12))
    assert client.board.applied[0][2] <= -D.q_min[5] - 0.04 + 1e-6


def test_it_does_not_enter_motor_mode_where_it_stands_by_its_own_order():
    client = Client("mode_refused")
    client.run(1.0, ZERO)
    assert "motor_ctrl_state" not in client.count


@pytest.mark.slow
@pytest.mark.parametrize(
    ("fault", "shows"),
    [
        ("motor_fault:RL_knee=8@+3", lambda c: int(c.last["spi_data"]["flags"][11]) & MOTOR_ERRORS == 8),
        ("motor_hot:FR_hip=85@+3", lambda c: int(c.last["spi_data"]["tmp_hip"][0]) == 850),
        ("motor_dead:FL_abad@+3", lambda c: (int(c.last["spi_data"]["flags"][3]) >> 30) & 3 == 0),
    ],
)
def test_faults_of_motors_are_in_its_messages(fault, shows):
    client = Client(fault)
    client.run(2.9, ZERO)
    assert not shows(client)
    client.run(0.3, ZERO)
    assert shows(client)


def test_a_silent_imu_stops_the_orientation_alone():
    client = Client("imu_silent@+1")
    client.run(1.5, ZERO)
    before = dict(client.count)
    client.run(0.5, ZERO)
    assert client.count["state_estimator"] == before["state_estimator"]
    assert client.count["spi_data"] > before["spi_data"]


@pytest.mark.slow
def test_late_and_lost_messages_are_late_and_lost():
    client = Client("frames_late=0.02@+2.7-3.2", "frames_lost=1@+3.5")
    client.run(2.69, ZERO)
    for _ in range(50):
        client.run(TICK, ZERO)
    assert client.err & 0x01 == 0 or client.flags
    before = client.count["spi_data"]
    client.run(1.5, ZERO)
    assert client.count["spi_data"] - before < 500


def test_faults_of_motors_on_can_are_refused():
    with pytest.raises(ConfigError, match="stock board has no fault 'power_cycle'; it has motor_dead"):
        Client("power_cycle:FL_hip@1")


def test_it_tells_which_joints_are_driven():
    client = ready()
    assert client.board.driven() == ()
    kp = np.zeros(12)
    kp[0] = 20.0  # the first place is FR_abad
    client.run(0.02, MOTOR_CTRL.encode(q_des=client.q(), kp_des=kp, kd_des=np.ones(12)))
    assert client.board.driven() == ("FR_abad",)
    client.run(0.02, MOTOR_CTRL.encode(q_des=client.q(), kd_des=np.ones(12)))
    assert client.board.driven() == ()


def test_negative_gains_of_a_damaged_message_do_not_reach_the_motors():
    client = ready()
    client.run(0.1, MOTOR_CTRL.encode(q_des=client.q() + 0.1, kp_des=[-200.0] * 12, kd_des=[-10.0] * 12))
    hips_and_knees = np.delete(client.tau(), [0, 3, 6, 9])  # an abad rests against its soft limit
    np.testing.assert_array_equal(hips_and_knees, 0.0)
