"""What is left of a joint, and what a calibration asks to log next."""

import numpy as np
import pytest

from mimic.sysid.result import UnexplainedResidual
from mimic.sysid.select.starts import PredictedMotion
from mimic.sysid.unexplained import next_logs, unexplained_residuals


def rest(joint: str, verdict: str, *depends_on: str) -> UnexplainedResidual:
    """Return what is left of a joint."""
    return UnexplainedResidual(
        joint=joint, ratio=3.0, state_r2=0.5, depends_on=depends_on, peak_hz=2.0, peak_ratio=3.0, verdict=verdict
    )


@pytest.mark.parametrize(
    ("verdict", "depends_on"),
    [("state-dependent", ("velocity", "torque")), ("state-dependent", ()), ("periodic", ("time",))]
    + [(verdict, ()) for verdict in ("events", "broadband", "periodic")],
)
def test_every_unexplained_joint_gets_a_motion(verdict: str, depends_on: tuple[str, ...]) -> None:
    lines = next_logs((rest("hip", "explained"), rest("knee", verdict, *depends_on)))
    assert len(lines) == max(len(depends_on), 1)
    assert all("knee" in line or "base" in line for line in lines)
    assert not any("hip" in line or "{" in line for line in lines)


def test_joints_with_the_same_need_share_a_line() -> None:
    assert next_logs((rest("hip", "broadband"), rest("knee", "broadband"))) == next_logs(
        (rest("hip, knee", "broadband"),)
    )


def test_nothing_is_asked_where_all_is_explained() -> None:
    assert next_logs((rest("hip", "explained"),)) == ()


T = np.arange(0.0, 24.0, 0.01)
RNG = np.random.default_rng(3)
NOISE = RNG.standard_normal(len(T))
Q = np.cumsum(RNG.standard_normal(len(T))) / 50


@pytest.mark.parametrize(
    ("more", "verdict", "depends_on"),
    [
        (0.0 * T, "explained", ()),
        (4.0 * np.sin(2 * np.pi * 1.7 * T), "periodic", ("time",)),
        (5.0 * np.abs(Q - Q.mean()), "state-dependent", ("position",)),
        (30.0 * (np.abs(T[:, None] - [4.2, 9.7, 16.4]) < 0.05).any(1), "events", ()),
        (NOISE, "broadband", ()),
    ],
)
def test_what_is_left_is_classified(more: np.ndarray, verdict: str, depends_on: tuple[str, ...]) -> None:
    motion = PredictedMotion(t=T, q=Q[:, None], dq=np.gradient(Q, T)[:, None], tau=np.roll(NOISE, 7)[:, None])
    target = Q[:, None] + RNG.standard_normal((len(T), 1))
    found = unexplained_residuals(
        ["hip"], (NOISE + more)[:, None], motion, target, np.floor(T).astype(int), np.array([0])
    )[0]
    assert found.verdict == verdict
    assert found.depends_on[: len(depends_on)] == depends_on
