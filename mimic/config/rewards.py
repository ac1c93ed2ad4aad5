"""Weights of the reward terms of stand_track, and how they change during a training."""

from __future__ import annotations

from mimic.frozen import frozen


@frozen
class RewardWeights:
    """Weight of each reward term: the reward of a control step is their sum times mimic.train.rewards.REWARD_SCALE.

    A weight is per unit of its term, which the docstring names; a term without a unit lies between 0 and 1.
    """

    alive: float = 0.5
    """1 in each control step."""
    height: float = 0.6
    """Base height follows the stand-up schedule."""
    upright: float = 1.0
    """Trunk tilt follows the stand-up schedule."""
    velocity: float = 10.0
    """Base velocity as asked."""
    heading: float = 4.0
    """Heading as asked."""
    gait: float = 20.0
    """Hind feet that step with the clock, or stand planted while the robot is asked to stand."""
    drift: float = -40.0
    """Distance from the rest position [per m]."""
    slip: float = -4.0
    """Squared speed and turning of toes on the ground [per m^2/s^2]."""
    foot_shift: float = -8.0
    """Way of the hind toes from where they began, while standing up [per m]."""
    terminations: float = -4.0
    """Each of the paper's terminations that holds."""
    flight: float = -0.5
    """Both hind toes in the air."""
    low: float = -0.3
    """Each front leg or hind knee on or near the ground."""
    action_rate: float = -0.012
    """Squared change of the action [per (unit of action)^2]."""
    unrest: float = -4.0
    """The same of the hind legs while the robot is asked to stand and does not topple [per (unit of action)^2]."""
    shuffle: float = -40.0
    """Speed of hind toes on the ground meanwhile [per m/s]."""
    torque: float = -0.03
    """Sum of squared torques, each as a share of its motor's largest."""
    heat: float = -5.0
    """The same up to a limit: it heats the windings."""
    overload: float = -1.5
    """Squared torque beyond the rated one, the same way."""
    joint_velocity: float = -3e-4
    """Sum of squared joint velocities [per rad^2/s^2]."""
    joint_speed: float = -0.02
    """Joint speed beyond the robot's limit [per rad/s]."""
    joint_acceleration: float = -1e-7
    """Sum of squared joint accelerations [per rad^2/s^4]."""
    limits: float = -6.0
    """Joint positions beyond their limits less a margin [per rad]."""
    fall: float = -2.0
    """The episode ends in a fall."""


REGULARISERS = ("action_rate", "torque", "joint_velocity", "joint_acceleration")
"""Reward terms that grow during training, once the robot stands."""


REFINING_TERMS = (
    "heat",
    "slip",
    "foot_shift",
    "terminations",
    "flight",
    "overload",
    "joint_speed",
)
"""Reward terms that hardly count before the robot stands. With all of them from the beginning a world loses more by
each step than by falling, and a policy learns to fall at once; that was tried."""


RESTING_TERMS = ("drift", "unrest", "shuffle")
"""Reward terms that count once robots may rest while they are asked to stand."""


@frozen
class FinishFactors:
    """What the weights of a few reward terms are multiplied by at the end of a training."""

    velocity: float = 3.5
    """Of the weight of that name, as all here."""
    heading: float = 2.5
    """Walking straight."""
    slip: float = 3.5
    """Sliding little."""
