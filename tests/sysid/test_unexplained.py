"""What a calibration asks to log next."""

import pytest

from mimic.sysid.result import UnexplainedResidual
from mimic.sysid.unexplained import next_logs


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
