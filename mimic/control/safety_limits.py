"""The limits of the safety rules, each with its reason.

Healthy extremes are those of 120 robots of the paper's Table II that stood up, followed random commands and sat down
(benchmarks/safety_envelope.py), the IMU read in steps of an MTi.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Limits:
    """The limit of each rule, and why it is there."""

    silent_ticks: int = 3
    """Control steps without an answer: 60 ms. One missing answer is common, three in a row are a broken wire."""
    silent_seconds: float = 0.055
    """… and this long [s]: after an overrun, steps may follow each other too fast for an answer."""
    failed_motors: int = 1
    """With one failed motor the other eleven may still bring the robot down; with two this was never tried."""
    temperature_warning: float = 65.0
    """[degC] Ten below the motor's own warning."""
    temperature: float = 72.0
    """[degC] The motor warns at 75 and faults at 80; sitting down takes seconds and should end before that."""
    rise_warning: float = 0.85
    """Of the winding's limit, by the thermal model."""
    rise: float = 0.95
    """… at which it sits down, which takes 2.5 s."""
    outside: float = 0.2
    """Joint reading beyond its limit [rad]; healthy none, with an earlier policy 0.02. Such a pose does not exist: the
    zero is wrong."""
    jump: float = 0.8
    """Change of a joint between two ticks [rad]; healthy at most 0.45, and no motor turns faster than 0.62 in 20 ms."""
    imu_age: float = 0.06
    """[s] Three ticks."""
    imu_repeats: int = 3
    """Orientations in a row with the same content while a policy moves the robot; healthy at most 1."""
    turn_mismatch: float = 0.12
    """Difference between the turn of the orientation and the rate of turn, per 20 ms [rad]; healthy at most 0.023, with
    earlier policies 0.042."""
    toes_apart: float = 0.10
    """Difference in height of the hind toes by legs and IMU while standing [m].

    A stepping healthy robot reaches 0.082, and 0.062 for the three ticks in a row that the rule needs. A roll of 0.37
    rad lifts one foot this much above the other.
    """
    toes_apart_moving: float = 0.2
    """… while standing up and sitting down; healthy at most 0.086."""
    front_above: float = 0.1
    """Height of the lower front toe over the lower hind toe while standing, at least [m]; healthy at least 0.29."""
    legs_ticks: int = 3
    """Ticks in a row in which legs and IMU contradict each other: 60 ms; a foot may be lifted for one."""
    upright: float = 0.85
    """Cosine between base x and the upright direction; healthy at least 0.975, pushed 0.94.

    Measured over 400 episodes of 10 s with robots of the paper's Table II, half of them pushed by 0.3 to 1.2 m/s every
    4 s: all 70 falls pass it, 0.18 s before the robot has fallen in the median; of the other 330 episodes none does."""
    fallen: float = 0.3
    """Cosine between base x and up; below, a robot that should stand has fallen. The limit of the training."""
    side_tilt: float = 0.75
    """Sine of the base's roll while standing up, sitting down or lying; healthy at most 0.30."""
    backward: float = -0.5
    """Up component of base z, while standing up or sitting down: below, the robot falls onto its back; healthy
    at least -0.11."""
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
    bus_errors: int = 12
    """Error frames within a tenth of a second: one for each motor."""
    rest_speed: float = 0.1
    """[rad/s] A joint slower than this rests."""
    rest_seconds: float = 0.5
    """[s]"""
    damp_seconds: float = 8.0
    """[s] An upright robot that is only damped, with 5 N m s/rad, comes to rest within 6.4 s."""
    interrupts_stop: int = 4
    """Number of Ctrl-C that switches a damped robot off before it rests."""


LIMITS = Limits()
