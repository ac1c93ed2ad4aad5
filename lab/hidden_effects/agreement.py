"""Do the two physics agree? mimic's prediction with the true numbers against the truth, in noise floors.

Each effect at the greatest size of the table, logs of 16 s without noise, predicted to the end of blocks. "Without" is
the prediction with the baseline parameters only. What is left with the true numbers is the step of the prediction, and
any disagreement about what an equation of the catalogue means.

    python -m lab.hidden_effects.agreement [NAME ...] > table.md
"""

from __future__ import annotations

import sys
from collections.abc import Sequence

import numpy as np

from lab.hidden_effects.families import FAMILIES
from lab.hidden_effects.generator import FLOOR, Machine, simulate
from lab.hidden_effects.scenarios import STRENGTHS, Scenario, build, reachable
from mimic.dynamics.catalogue import CATALOGUE
from mimic.dynamics.effect_set import EffectSet, EffectValues
from mimic.dynamics.machine import hung_robot
from mimic.io.joint_log import JointLog
from mimic.records import JOINTS, FloatArray
from mimic.robot.description import load_description
from mimic.sysid.predict import predict


def true_effects(machine: Machine, hidden: bool) -> EffectSet:
    """Return everything true about a machine, or only what every model has."""
    rows = {"coulomb": ("level", machine.friction), "viscous": ("coefficient", machine.damping)}
    rows["link_mass"] = ("factor", machine.mass)
    declared = [EffectValues(name=n, joints=JOINTS, values={p: v}) for n, (p, v) in rows.items()]
    declared.append(EffectValues(name="delay", values={"time": np.array([machine.delay])}))
    return EffectSet((*declared, *(machine.hidden if hidden else ())))


def disagreement(scenario: Scenario) -> tuple[FloatArray, FloatArray]:
    """Return what the prediction leaves without and with the hidden effects, each (12,) in noise floors."""
    built = build(scenario)
    truth = simulate(built.machine, built.motion, built.seed)
    log = JointLog(joints=JOINTS, t=truth.t, q=truth.q, q_des=truth.q_des)
    robot = hung_robot(load_description("cyberdog2"))
    left = []
    for hidden in (False, True):
        residual = predict(log, robot, true_effects(built.machine, hidden))
        left.append(np.sqrt(np.nanmean(residual**2, axis=0)) / FLOOR)
    return left[0], left[1]


def main(names: Sequence[str]) -> None:
    print("| effect | strength | without | with its true numbers |\n|---|---|---|---|")
    for name in names or [n for n, e in CATALOGUE.items() if n in FAMILIES and not e.random]:
        strength = next((s for s in STRENGTHS if reachable(name, s)), None)
        if strength is None:
            print(f"| {name} | not reached by this robot | - | - |")
            continue
        without, with_it = disagreement(Scenario(group="single", names=(name,), strength=strength, seconds=16.0))
        print(f"| {name} | {strength} | {without.max():.1f} | {with_it.max():.2f} |", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
