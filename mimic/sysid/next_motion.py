"""The motion to log next: the one under which two explanations of a machine differ most (T-optimal design).

Source: A. C. Atkinson and V. V. Fedorov, The design of experiments for discriminating between two rival models,
Biometrika 62 (1975). Both models have the numbers that they were fitted with; a fit to the new log may bring them
closer to each other.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mimic.config.sysid import LogSettings
from mimic.dynamics.effect_set import EffectSet
from mimic.dynamics.excitation import SECTIONS, probe_targets
from mimic.dynamics.machine import MachineModel
from mimic.io.joint_log import JointLog
from mimic.records import FloatArray
from mimic.sysid.predict import simulate_log

SECONDS = 20.0
"""Length of the motion [s]."""

LEAST = 1.0
"""Less far apart two explanations are not told from each other [noise floors]."""

SIZES = (0.3, 1.0)
"""Shares of the joints' ranges that are tried."""

EXACT = LogSettings(noise=0.0, resolution=0.0, torque_noise=0.0, timestep=0.001)
"""How a machine is predicted: as the model is, without the noise of readings."""


@dataclass(frozen=True, kw_only=True, eq=False)
class NextMotion:
    """A motion that tells two explanations from each other."""

    kind: str
    """Of `mimic.dynamics.excitation.probe_targets`."""
    size: float
    """Share of the joints' ranges that it uses."""
    apart: float
    """How far apart the two predict the joint that tells most, root mean square, in noise floors."""
    joint: str
    """That joint."""
    log: JointLog
    """Targets (T, J) [rad or m], and in q what the first explanation predicts."""

    @property
    def tells(self) -> bool:
        """Whether the two can be told apart by it."""
        return self.apart >= LEAST


def next_motion(
    machine: MachineModel, logs: Sequence[JointLog], noise: FloatArray, first: EffectSet, second: EffectSet
) -> NextMotion:
    """Return the motion that tells two sets of effects apart, inside the ranges that the logs have been in.

    Args:
        machine: The model.
        logs: Of the machine, with targets.
        noise: Noise floor of each joint (J,) [rad or m].
        first: What was found.
        second: The other explanation.

    Raises:
        ConfigError: If a joint was not moved, so that no range is known.
    """
    ordered = [log.of(machine.joints).q_des for log in logs]
    targets = np.concatenate([q_des for q_des in ordered if q_des is not None])
    low = targets.min(0)
    high = targets.max(0)
    centre = (low + high) / 2
    tried = []
    for kind in SECTIONS:
        for size in SIZES:
            moved = probe_targets(low, high, centre, seconds=SECONDS, rate_hz=EXACT.rate_hz, kind=kind, size=size)
            made, other = (simulate_log(machine, moved.t, moved.q_des, one, EXACT) for one in (first, second))
            apart = np.sqrt(((made.q - other.q) ** 2).mean(0)) / noise
            most = int(np.argmax(apart))
            log = replace(made, metadata={**made.metadata, "motion": kind})
            tried.append(
                NextMotion(kind=kind, size=size, apart=float(apart[most]), joint=machine.joints[most], log=log)
            )
    return max(tried, key=lambda one: one.apart)
