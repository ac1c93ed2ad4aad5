from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from mimic.emulator.imu import MtiSample, encode_mti
from mimic.errors import ConfigError, FrameError
from mimic.hardware.can.frame import CanFrame
from mimic.hardware.can.wiring import ImuWiring
from mimic.hardware.motors.imu import XsensMti, decode_mti, make_imu

LEVEL = np.array([1.0, 0.0, 0.0, 0.0])
rotations = st.tuples(*[st.floats(-3, 3)] * 3).map(lambda v: Rotation.from_rotvec(np.array(v)))


def words(rotation: Rotation) -> np.ndarray:
    return rotation.as_quat(scalar_first=True)


def feed(imu: XsensMti, t: float, **sample: object) -> None:
    assert all([imu.feed(frame, t) for frame in encode_mti(MtiSample(**sample))])


def test_frames_are_those_of_the_makers_tables():
    frames = encode_mti(MtiSample(time=1000, counter=7, status=3, quat_WI=LEVEL, omega_I=np.array([1.0, -2.0, 0.5])))
    expected = ["005#000003E8", "006#0007", "011#00000003", "021#7FFF000000000000", "032#0200FC000100"]
    assert [str(frame) for frame in frames] == expected


@given(rotations)
def test_an_orientation_arrives_within_a_word(rotation):
    (frame,) = encode_mti(MtiSample(quat_WI=words(rotation)))
    got = decode_mti(frame)["quat_WI"]
    assert (rotation.inv() * Rotation.from_quat(got, scalar_first=True)).magnitude() < 2e-4


@given(st.tuples(*[st.floats(-100, 100)] * 3))
def test_a_rate_of_turn_arrives_within_half_a_word_and_saturates(omega):
    (frame,) = encode_mti(MtiSample(omega_I=np.array(omega)))
    assert np.abs(decode_mti(frame)["omega_I"] - np.clip(omega, -64, 64)).max() <= 0.5 / 512 + 1 / 512


@pytest.mark.parametrize(
    ("frame", "says"),
    [
        (CanFrame(0x021, bytes(6), extended=False), "6 bytes"),
        (CanFrame(0x032, bytes(8), extended=False), "8 bytes"),
        (CanFrame(0x011, b"", extended=False), "0 bytes"),
        (CanFrame(0x021, bytes(8), extended=False), "length 0.000"),
        (CanFrame(0x021, bytes.fromhex("7FFF7FFF00000000"), extended=False), "length 1.414"),
    ],
)
def test_a_malformed_frame_is_refused_and_changes_nothing(frame, says):
    imu = XsensMti(LEVEL)
    with pytest.raises(FrameError, match=says):
        imu.feed(frame, 1.0)
    assert imu.reading(1.0).count == 0


@pytest.mark.parametrize("frame", [CanFrame(0x021, bytes(8)), CanFrame(0x0F4, bytes(6), extended=False)])
def test_frames_of_others_are_left_alone(frame):
    assert not XsensMti(LEVEL).feed(frame, 0.0)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_numbers_that_are_not_finite_are_not_sent(bad):
    with pytest.raises(FrameError, match="finite"):
        encode_mti(MtiSample(omega_I=np.array([0.0, bad, 0.0])))


def test_before_anything_came_there_is_no_reading():
    reading = XsensMti(LEVEL).reading(5.0)
    assert np.isnan(reading.quat_WB).all()
    assert np.isnan(reading.omega_B).all()
    assert "not sent" in reading.problem
    assert (reading.count, reading.valid, reading.age) == (0, None, np.inf)


@given(rotations, rotations)
def test_the_mounting_is_undone(base, mount):
    """A base turned by ``base`` that turns about its own z axis, seen by an IMU mounted askew."""
    imu = XsensMti(words(mount))
    feed(imu, 0.0, quat_WI=words(base * mount), omega_I=mount.inv().apply([0.0, 0.0, 1.0]))
    reading = imu.reading(0.0)
    turned = base.inv() * Rotation.from_quat(reading.quat_WB, scalar_first=True)
    assert turned.magnitude() < 3e-4
    assert np.abs(reading.omega_B - [0, 0, 1]).max() < 3e-3


def test_a_reading_is_as_old_as_its_older_half():
    imu = XsensMti(LEVEL)
    feed(imu, 1.0, quat_WI=LEVEL)
    assert imu.reading(1.0).problem is not None
    feed(imu, 1.01, omega_I=np.zeros(3))
    assert imu.reading(1.02).age == pytest.approx(0.02)
    assert imu.reading(1.02).problem is None


def test_a_stale_reading_is_no_reading():
    imu = XsensMti(LEVEL)
    feed(imu, 1.0, quat_WI=LEVEL, omega_I=np.zeros(3))
    assert np.isfinite(imu.reading(1.029).quat_WB).all()
    late = imu.reading(1.07)
    assert np.isnan(late.quat_WB).all()
    assert np.isnan(late.omega_B).all()
    assert "silent for 70 ms" in late.problem


def test_a_counter_that_stands_still_is_a_frozen_imu():
    imu = XsensMti(LEVEL)
    for i in range(20):
        feed(imu, 0.01 * i, counter=min(i, 9), quat_WI=LEVEL, omega_I=np.zeros(3))
    reading = imu.reading(0.19)
    assert reading.unchanged == pytest.approx(0.10)
    assert "repeated itself" in reading.problem


def test_without_a_counter_a_robot_at_rest_is_no_problem():
    imu = XsensMti(LEVEL)
    for i in range(20):
        feed(imu, 0.01 * i, quat_WI=LEVEL, omega_I=np.zeros(3))
    reading = imu.reading(0.19)
    assert reading.problem is None


def test_a_counter_that_runs_over_the_same_content_is_no_problem():
    imu = XsensMti(LEVEL)
    for i in range(20):
        feed(imu, 0.01 * i, counter=i, quat_WI=LEVEL, omega_I=np.zeros(3))
    reading = imu.reading(0.19)
    assert reading.problem is None
    assert reading.unchanged == 0.0


@pytest.mark.parametrize(("status", "valid"), [(0b11, True), (0b01, False)])
def test_the_imus_own_word_on_its_orientation_counts(status, valid):
    imu = XsensMti(LEVEL)
    feed(imu, 0.0, status=status, quat_WI=LEVEL, omega_I=np.zeros(3))
    reading = imu.reading(0.0)
    assert reading.valid is valid
    assert (reading.problem is None) is valid


def test_an_unknown_kind_is_refused():
    wiring = ImuWiring(kind="abacus", bus=0, quat_BI=LEVEL, rate={})
    with pytest.raises(ConfigError, match="xsens_mti"):
        make_imu(wiring)
