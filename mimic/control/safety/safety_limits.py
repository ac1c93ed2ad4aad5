"""The limits of the safety rules: those of any robot, each with its reason, and those of its description."""

from __future__ import annotations

from dataclasses import asdict

from mimic.frozen import frozen
from mimic.robot.description import RobotDescription
from mimic.robot.parts import SafetyNumbers


@frozen
class Limits(SafetyNumbers):
    """The limit of each rule, and why it is there."""

    silent_ticks: int = 5
    """Control steps without an answer: 100 ms, after which robots without any bus still stood (8 of 8; 7 of 8 after
    150 ms)."""
    silent_seconds: float = 0.095
    """… and this long [s]: after an overrun, steps may follow each other too fast for an answer."""
    failed_motors: int = 1
    """With one failed motor the other eleven may still bring the robot down; with two this was never tried."""
    rise_warning: float = 0.85
    """Of the winding's limit, by the thermal model."""
    rise: float = 0.95
    """… at which it sits down, which takes 2.5 s."""
    outside: float = 0.2
    """Joint reading beyond its limit [rad]; healthy none, with an earlier policy 0.02. Such a pose does not exist: the
    zero is wrong."""
    imu_age: float = 0.12
    """[s] Six ticks; robots without an orientation for 300 ms still stood (8 of 8)."""
    doubt_ticks: int = 3
    """Orientations in a row that contradict the rate of turn; fewer are left out as if they had not come."""
    frozen_ticks: int = 16
    """Readings in a row of one joint that are equal to the last bit, …"""
    frozen_targets: float = 0.15
    """… while its target moved by this [rad]. In 30 minutes of standing, simulated, at most 0.024 over so many readings
    rounded as CyberGear rounds them (0.38 mrad), and 0.061 rounded to 1 mrad with noise of 0.3 mrad."""
    off_target: float = 0.8
    """Distance of a joint from its target [rad] …"""
    off_target_ticks: int = 25
    """… in so many steps in a row: half a second. Healthy at most 0.38 rad for so long."""
    imu_repeats: int = 3
    """Orientations in a row with the same content while a policy moves the robot; healthy at most 1."""
    legs_ticks: int = 3
    """Ticks in a row in which legs and IMU contradict each other: 60 ms; a foot may be lifted for one."""
    fallen: float = 0.3
    """Cosine between base x and up; below, a robot that should stand has fallen. The limit of the training."""
    overrun: float = 0.010
    """A step that ends this much later than planned [s]: half a control step."""
    overrun_ticks: int = 3
    """Overruns in a row."""
    small_overrun: float = 0.002
    """A smaller overrun [s]: a tenth of a control step."""
    small_overruns_logged: int = 3
    """Smaller overruns in a row that are logged."""
    small_overrun_ticks: int = 25
    """Smaller overruns in a row: half a second. The policy was trained with delays of up to 35 ms, so one of 2 ms does
    no harm; half a second of them shows that the computer cannot keep up."""
    longest_overrun: float = 0.1
    """One overrun this long [s]: five control steps without a command."""
    sender_age: float = 0.06
    """Age of the newest report of the process that sends [s]; one comes every 3 ms."""
    bus_errors: int = 12
    """Error frames within a tenth of a second: one for each motor."""
    slow_answers: float = 0.02
    """From a question to its answer, median of half a second, that is announced [s]; a quiet bus takes 1 to 5 ms."""
    slowest_answers: float = 0.06
    """… at which it sits down [s]: 30 ms each way, with which 8 of 8 robots still stood; with 40 ms it were 7."""
    foreign_storm: int = 12
    """Commands of another program within a tenth of a second: as many as the robot has motors. Sitting down needs
    motors that follow one program."""
    rest_seconds: float = 0.5
    """[s]"""


def limits_for(description: RobotDescription) -> Limits:
    """Return the limits of the rules for a robot."""
    return Limits(**asdict(description.safety))
