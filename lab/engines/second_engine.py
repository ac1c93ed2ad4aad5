"""The policy in a second physics engine: Drake, which shares no code with MuJoCo.

    python -m lab.engines.second_engine --robots 40 --out second_engine.json

Drake reads the robot's MJCF with its own parser; bodies, joints, solver (SAP) and contacts (compliant points) are its
own. The law of the motors is written here once more from the numbers of the robot description: gains, limits of torque
and speed, dry friction, delay. Control loop, policy and rules are the product's. Robots are randomised as in the
paper's Table II, except for the restitution, which Drake's contacts do not have; no part of the robot touches another.
Each episode is also played in MuJoCo.

Needs Drake, which mimic does not: pip install drake.
"""

from __future__ import annotations

import argparse
import importlib
import importlib.util
import json
import logging
import sys
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from lab.policies.standing import standing_track
from lab.policies.studies.calm import SETTLED
from mimic.config.play import NOMINAL, Randomisation
from mimic.control.plant import Plant
from mimic.dynamics.lying import RESTS, RESTS_FOR, SINKS_WITHIN
from mimic.dynamics.robot_model import Variation, draw_variation, load_model
from mimic.errors import PlantError
from mimic.evaluation.episode import OF_EPISODES, play_episode
from mimic.evaluation.policy import TIMING, command_script, forward_speed, stands_at_end
from mimic.metrics import run_metrics, stand_up_time
from mimic.policy.runtime import Policy
from mimic.records import JOINTS, FloatArray, Health, JointCommand, RobotState, Tick
from mimic.robot.description import RobotDescription, load_description
from mimic.simulation.plant import SimulatedPlant

STEP = 5e-4
"""Physics step [s]."""

STIFFNESS, RELAXATION = 3e4, 0.01
"""Of a contact point [N/m], and the time in which it comes to rest [s]."""

SINK_STEP = 2 * STEP
"""Torques hold for so long while the robot sinks [s]."""

RUB = 0.02
"""Speed at which dry friction has three quarters of its size [rad/s]."""


def plain_mjcf(path: Path) -> str:
    """Return an MJCF without what Drake does not know or need: motors, keyframes, sites and visual shapes."""
    root = ET.parse(path).getroot()
    for parent in list(root.iter()):
        for child in list(parent):
            drawn = child.tag == "geom" and child.get("class") == "visual"
            if drawn or child.tag in ("actuator", "keyframe", "asset", "sensor", "dcmotor", "site"):
                parent.remove(child)
    return ET.tostring(root, encoding="unicode")


def engine() -> Any:
    """Return Drake, which has no stubs here."""
    return importlib.import_module("pydrake.all")


class DrakePlant:
    """The robot in Drake, one variation of it."""

    def __init__(self, description: RobotDescription, *, ranges: Randomisation, seed: int) -> None:
        self._drake = drake = engine()
        self._d, self._rng = description, np.random.default_rng(seed)
        self._phases = np.random.default_rng([seed, 29])
        self._ranges = ranges
        self.variation: Variation = draw_variation(ranges, STEP, self._rng)
        v = self.variation
        builder = drake.DiagramBuilder()
        config = drake.MultibodyPlantConfig(time_step=STEP, discrete_contact_approximation="sap")
        plant, scene = drake.AddMultibodyPlant(config, builder)
        (robot,) = drake.Parser(plant).AddModelsFromString(plain_mjcf(description.mjcf), "xml")
        ground = drake.ProximityProperties()
        friction = drake.CoulombFriction(v.ground_friction, v.ground_friction)
        drake.AddContactMaterial(point_stiffness=STIFFNESS, friction=friction, properties=ground)
        ground.AddProperty("material", "relaxation_time", RELAXATION)
        plant.RegisterCollisionGeometry(plant.world_body(), drake.RigidTransform(), drake.HalfSpace(), "ground", ground)
        shapes = [
            g for b in plant.GetBodyIndices(robot) for g in plant.GetCollisionGeometriesForBody(plant.get_body(b))
        ]
        for shape in shapes:  # MuJoCo takes the ground's numbers; Drake combines those of both
            own = drake.ProximityProperties(scene.model_inspector().GetProximityProperties(shape))
            for name in ("coulomb_friction", "point_contact_stiffness", "relaxation_time"):
                if own.HasProperty("material", name):
                    own.RemoveProperty("material", name)
            drake.AddContactMaterial(point_stiffness=STIFFNESS, friction=friction, properties=own)
            own.AddProperty("material", "relaxation_time", RELAXATION)
            scene.AssignRole(plant.get_source_id(), shape, own, drake.RoleAssign.kReplace)
        scene.collision_filter_manager().Apply(
            drake.CollisionFilterDeclaration().ExcludeWithin(drake.GeometrySet(shapes))
        )
        self._joints = [plant.GetJointByName(name) for name in JOINTS]
        for joint, armature in zip(self._joints, description.armature, strict=True):
            motor = plant.AddJointActuator(joint.name(), joint)
            motor.set_default_rotor_inertia(armature)
            motor.set_default_gear_ratio(1.0)
        plant.Finalize()
        self.plant = plant
        diagram = builder.Build()
        self._simulator = drake.Simulator(diagram)
        self._root = self._simulator.get_mutable_context()
        self._context = plant.GetMyMutableContextFromRoot(self._root)
        self._at_q = np.array([j.position_start() for j in self._joints])
        self._at_v = np.array([j.velocity_start() for j in self._joints])
        order = [plant.GetJointActuatorByName(n).input_start() for n in JOINTS]
        self._at_u = np.array(order)
        self._vary(v)

    def _vary(self, v: Variation) -> None:
        plant, context = self.plant, self._context
        added = {"base": v.base_mass}
        for i, leg in enumerate(("FL", "FR", "RL", "RR")):
            added[f"{leg}_abad"] = v.abad_mass[i]
            added[f"{leg}_hip"] = v.hip_mass[i]
            added[f"{leg}_knee"] = v.knee_mass[i] + v.toe_mass[i]
        for name, extra in added.items():
            body = plant.GetBodyByName(name)
            own = body.CalcSpatialInertiaInBodyFrame(context)
            mass, com = own.get_mass() + extra, own.get_com()
            unit = own.Shift(com).get_unit_inertia()
            shift = v.com if name == "base" else np.zeros(3)
            inertia = self._drake.SpatialInertia.MakeFromCentralInertia(mass, com + shift, unit * mass)
            body.SetSpatialInertiaInBodyFrame(context, inertia)
        nominal = load_model(self._d, visuals=False)
        self._dry = nominal.dof_frictionloss[6:] * v.dry_friction
        for joint, damping in zip(self._joints, nominal.dof_damping[6:] * v.viscous_friction, strict=True):
            joint.SetDamping(context, float(damping))

    @property
    def description(self) -> RobotDescription:
        """The robot's numbers."""
        return self._d

    def start(self) -> RobotState:
        """Let the robot sink from its folded legs onto the ground, as without power, and return its state."""
        d, v = self._d, self.variation
        q = np.zeros(19)
        q[:4] = np.cos(v.heading / 2), 0.0, 0.0, np.sin(v.heading / 2)
        q[6] = d.pose_height["lie"] + 0.005 + v.start_height
        q[self._at_q] = np.clip(d.poses["lie"] + v.start_q, d.q_min + 0.01, d.q_max - 0.01)
        self.plant.SetPositions(self._context, q)
        self.plant.SetVelocities(self._context, np.zeros(18))
        self._root.SetTime(0.0)
        self._simulator.Initialize()
        self._sink()
        lying = self.plant.GetPositions(self._context)[self._at_q].copy()
        self._targets = [lying] * 5
        self._tau, self._steps = np.zeros(12), 0
        self._next_push = self._ranges.push_interval + self._phases.uniform(0.0, 0.25)
        return self._state()

    def _sink(self) -> None:
        """Let the robot come to rest without torques of its motors; time is then zero again."""
        still = 0.0
        while still < RESTS_FOR and self._root.get_time() < SINKS_WITHIN:
            v = self.plant.GetVelocities(self._context)
            still = still + SINK_STEP if np.abs(v).max() < RESTS else 0.0
            self._advance(np.zeros(12), v[self._at_v], self._root.get_time() + SINK_STEP)
        self.plant.SetVelocities(self._context, np.zeros(18))
        self._root.SetTime(0.0)
        self._simulator.Initialize()

    def _advance(self, tau: FloatArray, v: FloatArray, until: float) -> None:
        """Go on to a time with torques of the motors (12,) [N m], less their dry friction at velocities (12,)."""
        u = np.zeros(12)
        u[self._at_u] = tau - self._dry * np.tanh(v / RUB)
        self.plant.get_actuation_input_port().FixValue(self._context, u)
        self._simulator.AdvanceTo(until)

    def _state(self) -> RobotState:
        q, v = self.plant.GetPositions(self._context), self.plant.GetVelocities(self._context)
        quat = q[:4] / np.linalg.norm(q[:4])
        turn = self.plant.GetFreeBodyPose(self._context, self.plant.GetBodyByName("base")).rotation().matrix()
        return RobotState(
            t=self._root.get_time() + OF_EPISODES["begin"],
            q=q[self._at_q].copy(),
            dq=v[self._at_v].copy(),
            tau=self._tau.copy(),
            quat_WB=quat,
            omega_B=turn.T @ v[:3],
            p_WB=q[4:7].copy(),
            v_WB=v[3:6].copy(),
        )

    def _torque(self, target: FloatArray, q: FloatArray, v: FloatArray, command: JointCommand) -> FloatArray:
        """Return the torques of the motors (12,): a position servo whose torque and speed are limited [N m]."""
        d = self._d
        tau = self.variation.kp * command.kp * (target - q) - self.variation.kd * command.kd * v
        slope = d.torque_max / (d.speed_max - d.speed_flat)  # less torque the faster it drives
        low, high = -slope * (d.speed_max + v), slope * (d.speed_max - v)
        return np.clip(np.clip(tau, low, high), -d.torque_max, d.torque_max)

    def step(self, command: JointCommand) -> Tick:
        """Send a command and let one control step pass.

        Raises:
            PlantError: If the simulation is no longer finite.
        """
        if self._ranges.push[1] > 0 and self._root.get_time() >= self._next_push:
            angle, speed = self._rng.uniform(-np.pi, np.pi), self._rng.uniform(*self._ranges.push)
            v = self.plant.GetVelocities(self._context).copy()
            v[3:5] += speed * np.cos(angle), speed * np.sin(angle)
            self.plant.SetVelocities(self._context, v)
            self._next_push += self._ranges.push_interval + self._phases.uniform(0.0, 0.25)
        self._targets = [command.q_des, *self._targets[:-1]]
        substeps, begin = round(self._d.dt / STEP), self._root.get_time()
        for k in range(substeps):
            late = k - self.variation.delay_steps  # physics steps since the newest command took effect
            age = max(0, -(late // substeps))
            target = self._targets[age]
            if command.ramp:
                share = (late + age * substeps + 1) / substeps
                target = self._targets[age + 1] + share * (target - self._targets[age + 1])
            q = self.plant.GetPositions(self._context)[self._at_q]
            v = self.plant.GetVelocities(self._context)[self._at_v]
            self._tau = self._torque(target, q, v, command)
            self._advance(self._tau, v, begin + (k + 1) * STEP)
        if not np.all(np.isfinite(self.plant.GetPositions(self._context))):
            raise PlantError(f"the simulation is no longer finite at {self._state().t:.2f} s")
        self._steps += 1
        none = np.zeros(12, dtype=np.int64)
        health = Health(
            age=np.zeros(12),
            missed=none,
            faults=none,
            running=np.ones(12, dtype=np.bool_),
            temperature=np.full(12, np.nan),
            imu_age=0.0,
            imu_unchanged=0.0,
            imu_count=self._steps,
            imu_valid=None,
            compute=0.0,
            late=0.0,
            bus_errors=0,
        )
        return Tick(state=self._state(), health=health, sent=command, samples=None)

    def damp(self) -> bool:
        """Return True: the commands of the loop damp it."""
        return True

    def close(self) -> None:
        """Do nothing; a simulated robot has nothing to release."""


def episode(
    plant: Plant, policy: Policy, seconds: float, seed: int, *, still: bool = False, **asked: Any
) -> dict[str, Any]:
    """Return the figures of one episode in which a robot stands up and reaches for goals, or stands still."""
    d = plant.description
    rng = np.random.default_rng([seed, 5])
    if still:
        track = standing_track(policy, seconds)
    else:
        track = command_script(d, seconds - TIMING.stand_up - TIMING.blend, rng, **asked)
    result = play_episode(plant, policy, track, TIMING)
    figures = run_metrics(result.log, d)
    there = result.log.p_WB[result.log.t >= SETTLED, :2]
    return {
        "stands": stands_at_end(result, d),
        "stood_up_s": float(stand_up_time(result.log, d)),
        "toe_error_m": 1e-2 * figures["toe_error_cm"]["mean"],
        "forward_m_s": forward_speed(result.log, SETTLED),
        "moved_m": float(np.linalg.norm(there[-1] - there[0])) if len(there) else float("nan"),
        "knee_rms_nm": figures["torque_nm"]["knee_rms"],
    }


def main(argv: list[str] | None = None) -> int:
    """Play the episodes in both engines, and print and write the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--policy", type=Path, default=Path("policies/stand_track.onnx"))
    parser.add_argument(
        "--robots", type=int, default=40, help="randomised robots; a fifth as many nominal ones of each kind"
    )
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--out", type=Path, default=None)
    options = parser.parse_args(argv)
    if importlib.util.find_spec("pydrake") is None:
        print("Drake is not installed; install it beside mimic: pip install drake", file=sys.stderr)
        return 2
    logging.getLogger("drake").setLevel(logging.ERROR)  # a warning for each MJCF attribute that it does not read
    description = load_description("cyberdog2")
    policy = Policy(options.policy, description)
    rows = []
    for kind, ranges, seed, seconds, asked in _jobs(options.robots, options.seconds):
        for engine, made, more in (("drake", DrakePlant, {}), ("mujoco", SimulatedPlant, OF_EPISODES)):
            figures = episode(made(description, ranges=ranges, seed=seed, **more), policy, seconds, seed, **asked)
            rows.append({"kind": kind, "seed": seed, "engine": engine, **figures})
        print(f"{kind} {seed}: {rows[-2]['stands']} {rows[-1]['stands']}", file=sys.stderr, flush=True)
        if options.out is not None:
            options.out.write_text(json.dumps(rows, indent=1))
    for kind in dict.fromkeys(r["kind"] for r in rows):
        for engine in ("drake", "mujoco"):
            own = [r for r in rows if r["kind"] == kind and r["engine"] == engine]
            print(f"{kind:12s} {engine:7s} {_summary(own)}")
    return 0


Job = tuple[str, Randomisation, int, float, dict[str, Any]]
"""Kind, ranges of the robot, seed, length [s], what is asked."""


def _jobs(robots: int, seconds: float) -> Iterator[Job]:
    few = max(robots // 5, 1)
    table2 = replace(Randomisation(), restitution=NOMINAL.restitution)
    for seed in range(robots):
        yield "randomised", table2, seed, seconds, {}
    for seed in range(few):
        yield "still", table2, seed, seconds, {"still": True}
    for seed in range(few):
        yield "goals", NOMINAL, seed, seconds, {"speed": 0.0, "turn": 0.0}
    for speed, seed in product((-0.3, 0.3), range(few)):
        yield f"walk {speed:+.1f}", NOMINAL, seed, 12.0, {"speed": speed, "turn": 0.0}


def _summary(rows: Sequence[dict[str, Any]]) -> str:
    """Return the figures of some episodes; all but the time to stand up are those of robots that stand."""
    stood = [row for row in rows if row["stands"]]

    def mean(name: str) -> float:
        return float(np.mean([row[name] for row in stood])) if stood else float("nan")

    return (
        f"{len(stood):3d} of {len(rows):3d} stand;"
        f" up after {np.median([row['stood_up_s'] for row in rows]):.2f} s;"
        f" toes {100 * mean('toe_error_m'):.2f} cm;"
        f" moved {mean('moved_m'):.2f} m;"
        f" forward {mean('forward_m_s'):+.3f} m/s;"
        f" knees {mean('knee_rms_nm'):.2f} N m"
    )


if __name__ == "__main__":
    sys.exit(main())
