"""The robot's left-right symmetry: what a state and an action look like in a mirror.

The robot is mirrored at the world's x-z plane, so that headings, y components and abad angles change their sign, left
and right legs change places, and the gait clock is half a cycle away.
"""

from __future__ import annotations

from functools import cache
from itertools import chain

import torch
from torch import Tensor

from mimic.policy.contract import AHEAD, ARM_TERMS, AVERAGED, FRAME_SIZE, TERMS

_JOINTS = ([3, 4, 5, 0, 1, 2, 9, 10, 11, 6, 7, 8], [-1.0, 1.0, 1.0] * 4)  # abad, hip, knee
_ARMS = [6 * k + i for k in range(2 * len(AHEAD)) for i in (3, 4, 5, 0, 1, 2)]
_AXIS = ([0, 1, 2], [1.0, -1.0, 1.0])
_TURN = ([0, 1, 2], [-1.0, 1.0, -1.0])
MIRRORED = {
    "joint_position": _JOINTS,
    "down": _AXIS,
    "forward": _AXIS,
    "last_action": _JOINTS,
    "velocity_command": ([0, 1], [1.0, -1.0]),
    "heading_error": ([0], [-1.0]),
    "clock": ([0, 1], [-1.0, -1.0]),
    "gyro": _TURN,
    "joint_velocity": _JOINTS,
    "arm_reference": (_ARMS, [-1.0, 1.0, 1.0] * 4 * len(AHEAD)),
    "arms_known": ([0], [1.0]),
}
"""For each term of a frame: which of its numbers comes where, and with which sign."""


@cache
def _image(device: torch.device, *names: str) -> tuple[Tensor, Tensor]:
    """Return the same for terms that stand one after another."""
    order: list[int] = []
    signs: list[float] = []
    for name in chain.from_iterable(AVERAGED if name == "slow_mean" else (name,) for name in names):
        places, sign = MIRRORED[name]
        order += [len(order) + i for i in places]
        signs += sign
    return torch.tensor(order, device=device), torch.tensor(signs, device=device)


def mirrored_actions(actions: Tensor) -> Tensor:
    """Return actions (N, 12) in the mirror."""
    order, signs = _image(actions.device, "last_action")
    return actions[:, order] * signs


def mirrored_observations(observations: Tensor) -> Tensor:
    """Return the policy's observations (N, observation_size) in the mirror."""
    frames, once = divmod(observations.shape[1], FRAME_SIZE)
    names = [name for name, _ in TERMS] * frames + [name for name, _ in ARM_TERMS] * bool(once)
    order, signs = _image(observations.device, *names)
    return observations[:, order] * signs
