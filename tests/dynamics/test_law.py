"""Each effect by what a joint on a bench does: a shaft without weight unless a test hangs something on it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from mimic.dynamics.catalogue import CATALOGUE
from mimic.dynamics.law import Law
from mimic.dynamics.machine import SOLREF_STEPS, MachineModel, read_machine
from mimic.dynamics.servo import Servo, neutral, static_model
from mimic.errors import ConfigError

INERTIA, ARMATURE = 0.02, 0.003

BENCH = """<mujoco><option gravity="{g} 0 0"/><worldbody>
<body name="a"><inertial pos="0 0 {arm}" mass="{mass}" diaginertia="{i} {i} {i}"/>
<joint name="a" axis="0 1 0" armature="{j}"/></body>
<body name="b" pos="0 5 0"><inertial pos="0 0 {arm}" mass="{mass}" diaginertia="{i} {i} {i}"/>
<joint name="b" axis="0 1 0" armature="{j}"/></body></worldbody></mujoco>"""


class Bench:
    """Two shafts that know nothing of each other, each with a drive."""

    def __init__(
        self,
        folder: Path,
        effects: dict | None = None,
        *,
        kp=30.0,
        kd=3.0,
        dt=0.0025,
        inertia=INERTIA,
        weight=0.0,
        drive: dict | None = None,
    ) -> None:
        path = folder / "bench.xml"
        # a weight of so many N m at q = 0: mass 1 kg on an arm of 0.1 m
        text = BENCH.format(g=10 * weight, arm=-0.1 if weight else 0, mass=1, i=inertia, j=ARMATURE)
        path.write_text(text)
        machine = read_machine(path, drive or {"kp": kp, "kd": kd})
        drives = replace(machine.drives, torque=np.full(2, 12.0), flat=np.full(2, 10.0), speed=np.full(2, 30.0))
        self.machine: MachineModel = machine if drive else replace(machine, drives=drives)
        p = {
            (name, key): np.full((1, 1 if CATALOGUE[name].scope == "machine" else 2), value)
            for name, values in (effects or {}).items()
            for key, value in values.items()
        }
        model = self.machine.model
        model.opt.timestep = dt
        model.dof_solref[:] = [SOLREF_STEPS * dt, 1.0]
        model.dof_solimp[:] = [0.99, 0.999, 0.001, 0.5, 2.0]
        static_model(model, self.machine, p)
        self.data = mujoco.MjData(model)
        self._begun = False
        self.law = Law(self.machine.drives, p, dt, (1, 2), np)
        d = self.data
        self._servo = Servo(
            ctrl=d.ctrl[None],
            applied=d.qfrc_applied[None],
            inertia=model.dof_armature[None],
            friction=model.dof_frictionloss[None],
            needed=d.qfrc_bias[None],
        )
        self.law.needed = self._servo.needed

    def run(
        self,
        seconds: float,
        target: Callable[[float], float] = lambda t: 0.0,
        force: Callable[[float], float] = lambda t: 0.0,
        speed: float = 0.0,
        rest: bool = False,
    ) -> dict[str, np.ndarray]:
        """Return time, position, speed, torque and reading of the first shaft; with ``rest`` the other rests."""
        d, law, other = self.data, self.law, np.array([1.0, 0.0 if rest else 1.0])
        if not self._begun:
            self._begun = True
            d.qvel[:] = speed * other
            law.begin(d.qpos[None].copy(), d.qvel[None].copy())
        rows = []
        for _ in range(round(seconds / self.machine.model.opt.timestep)):
            wanted = target(d.time) * other
            inputs = law.step(d.qpos[None], d.qvel[None], wanted[None], d.time, (force(d.time) * other)[None])
            self._servo.write(inputs)
            mujoco.mj_step(self.machine.model, d)
            law.settle(d.qvel[None])
            rows.append((d.time, d.qpos[0], d.qvel[0], inputs.tau[0, 0], law.reading(d.qpos[None])[0, 0]))
        return dict(zip(("t", "q", "dq", "tau", "reading"), np.array(rows).T, strict=True))


@pytest.fixture
def bench(tmp_path: Path) -> Callable[..., Bench]:
    return lambda effects=None, **options: Bench(tmp_path, effects, **options)


FREE = {"kp": 0.0, "kd": 0.0}
"""No servo: the torque is what ``force`` says."""

WHOLE = INERTIA + ARMATURE


def pull(made: Bench, torque: float, seconds: float = 0.5, **options) -> dict[str, np.ndarray]:
    return made.run(seconds, force=lambda t: torque, **options)


# ---------------------------------------------------------------------- friction


def test_dry_friction_holds_up_to_its_level_and_takes_it_from_then_on(bench):
    assert abs(pull(bench({"coulomb": {"level": 0.2}}, **FREE), 0.19)["q"][-1]) < 5e-4
    assert pull(bench({"coulomb": {"level": 0.2}}, **FREE), 0.3)["dq"][-1] == pytest.approx(0.5 * 0.1 / WHOLE, rel=0.02)


def test_stribeck_friction_adds_to_breaking_away_and_is_gone_at_speed(bench):
    both = {"coulomb": {"level": 0.2}, "stribeck": {"level": 0.1, "speed": 0.05}}
    assert abs(pull(bench(both, **FREE), 0.28)["q"][-1]) < 5e-4
    assert pull(bench(both, **FREE), 0.32)["q"][-1] > 0.1
    moving = pull(bench(both, **FREE), 0.2, speed=1.0)["dq"]
    assert moving[-1] == pytest.approx(1.0, abs=0.01)


@pytest.mark.parametrize("torque", [0.5, 2.0])
def test_load_friction_grows_with_the_torque_of_the_motor(bench, torque):
    made = pull(bench({"load_friction": {"ratio": 0.25}}, **FREE), torque, 0.1)
    assert made["dq"][-1] == pytest.approx(0.1 * 0.75 * torque / WHOLE, rel=0.02)


def test_load_friction_leaves_an_idle_motor_alone(bench):
    assert bench({"load_friction": {"ratio": 0.5}}, **FREE).run(0.2, speed=2.0)["dq"][-1] == pytest.approx(2.0)


def test_friction_of_a_gear_takes_the_same_share_of_what_the_motor_and_what_a_weight_ask_of_it(bench):
    loaded = {"gear_load_friction": {"ratio": 0.25}}
    driven = pull(bench(loaded, **FREE), 2.0, 0.1)
    assert driven["dq"][-1] == pytest.approx(0.1 * 0.75 * 2.0 / WHOLE, rel=0.02)
    falls, braked = (bench(e, weight=0.5, **FREE).run(0.05)["dq"][-1] for e in ({}, loaded))
    assert abs(falls) > 0.2
    assert braked == pytest.approx(0.75 * falls, rel=0.02)


def test_asymmetric_friction_brakes_one_direction_more(bench):
    effects = {"coulomb": {"level": 0.1}, "asymmetric_friction": {"level": 0.04, "coefficient": 0.0}}
    slowed = [2.0 - abs(bench(effects, **FREE).run(0.1, speed=v)["dq"][-1]) for v in (2.0, -2.0)]
    assert slowed == pytest.approx([0.1 * 0.14 / WHOLE, 0.1 * 0.06 / WHOLE], rel=0.02)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_asymmetric_friction_holds_more_against_one_direction(bench, sign):
    """At rest too: 0.14 N m forward, 0.06 backward."""
    effects = {"coulomb": {"level": 0.1}, "asymmetric_friction": {"level": 0.04, "coefficient": 0.0}}
    holds = 0.1 + 0.04 * sign
    assert abs(pull(bench(effects, **FREE), sign * (holds - 0.01))["q"][-1]) < 5e-4
    assert sign * pull(bench(effects, **FREE), sign * (holds + 0.02))["q"][-1] > 0.05


def test_asymmetric_friction_never_drives(bench):
    """More of it than dry friction leaves one direction without."""
    effects = {"coulomb": {"level": 0.1}, "asymmetric_friction": {"level": 0.3, "coefficient": 0.0}}
    assert abs(pull(bench(effects, **FREE), 0.0)["q"][-1]) < 5e-4
    assert bench(effects, **FREE).run(0.1, speed=-2.0)["dq"][-1] == pytest.approx(-2.0, abs=1e-3)
    assert bench(effects, **FREE).run(0.1, speed=2.0)["dq"][-1] == pytest.approx(2.0 - 0.1 * 0.4 / WHOLE, rel=0.02)


def test_asymmetric_viscous_friction_pushes_the_same_way_in_both_directions(bench):
    effects = {"asymmetric_friction": {"level": 0.0, "coefficient": 0.01}}
    ends = [bench(effects, **FREE).run(0.1, speed=v)["dq"][-1] for v in (2.0, -2.0)]
    assert ends[0] < 2.0 - 0.05
    assert ends[1] < -2.0 - 0.05


def test_quadratic_drag_slows_like_one_over_time(bench):
    made = bench({"quadratic_drag": {"coefficient": 0.01}}, **FREE).run(1.0, speed=10.0)
    assert made["dq"][-1] == pytest.approx(1 / (1 / 10 + 1.0 * 0.01 / WHOLE), rel=0.02)


def test_coupling_drags_with_the_speed_of_the_neighbour(bench):
    made = bench({"coupling": {"coefficient": 0.05}}, **FREE)
    made.machine.drives.neighbour[:] = 1, 0
    made.run(0.01, speed=4.0, rest=True)
    assert made.data.qvel[1] == pytest.approx(-0.01 * 0.05 * 4.0 / WHOLE, rel=0.03)


# ---------------------------------------------------------------------- torque


def test_a_stalled_motor_gives_its_torque_and_a_free_one_runs_to_its_speed(bench):
    effects = {"torque_speed": {"torque": 4.0, "speed": 12.0, "flat": 6.0}}
    assert bench(effects, inertia=1e5).run(0.05, target=lambda t: 5.0)["tau"][-1] == pytest.approx(4.0)
    free = bench(effects, kp=1.0, kd=0.0, dt=0.0005).run(0.8, target=lambda t: 90.0)
    assert free["dq"][-1] == pytest.approx(12.0, rel=0.01)
    halfway = free["tau"][np.argmin(np.abs(free["dq"] - 9.0))]
    assert halfway == pytest.approx(2.0, abs=0.15)


def test_a_motor_brakes_with_its_whole_torque_at_any_speed(bench):
    effects = {"torque_speed": {"torque": 4.0, "speed": 12.0, "flat": 0.0}}
    made = bench(effects, inertia=1e5).run(0.02, target=lambda t: -90.0, speed=11.0)
    assert made["tau"][-1] == pytest.approx(-4.0)


def test_a_sagging_supply_weakens_both_shafts_by_what_either_draws(bench):
    def limit(rest: bool) -> float:
        made = bench({"supply_sag": {"drop": 0.002}}, inertia=1e5)
        return made.run(0.05, target=lambda t: 90.0, speed=8.0, rest=rest)["tau"][-1]

    one, two = limit(True), limit(False)
    assert one == pytest.approx(12.0 / (1 + 0.002 * 12.0 * 8.0), rel=1e-4)
    assert two < one - 0.5


@pytest.mark.parametrize("dt", [0.0005, 0.005])
def test_a_supply_that_sags_much_settles_where_what_is_drawn_leaves_it(bench, dt):
    """At once: torques that follow the draw of the step before would jump up and down."""
    drop, speed = 0.02, 8.0
    tau = bench({"supply_sag": {"drop": drop}}, inertia=1e5, dt=dt).run(0.05, lambda t: 90.0, speed=speed)["tau"]
    left = 1.0 - drop * 2 * speed * tau[-1]  # two shafts alike
    assert tau[-1] == pytest.approx(12.0 * (30.0 * left - speed) / (20.0 * left) * left, rel=1e-3)
    assert np.ptp(tau) < 1e-3


def test_the_torque_constant_scales_torque(bench):
    plain, weak = (
        bench(e, inertia=1e5).run(0.05, target=lambda t: 0.1)["tau"][-1] for e in ({}, {"kt_gain": {"factor": 0.8}})
    )
    assert weak / plain == pytest.approx(0.8)


def test_drift_grows_with_time(bench):
    made = bench({"kt_drift": {"rate": -0.4}}, inertia=1e7)
    early = made.run(0.05, target=lambda t: 0.1)["tau"][-1]
    made.data.time = 50.0
    assert [early, made.run(0.05, target=lambda t: 0.1)["tau"][-1]] == pytest.approx([3.0, 2.4], rel=0.01)


def test_heat_takes_torque_with_its_time_constant(bench):
    made = bench({"kt_heat": {"loss": 0.002, "time": 0.5}}, inertia=1e7).run(4.0, target=lambda t: 0.1)
    hot = made["tau"][-1]
    assert hot == pytest.approx(3.0 * (1 - 0.002 * hot**2), rel=0.001)
    after_one = made["tau"][np.searchsorted(made["t"], 0.5)]
    assert (3.0 - after_one) / (3.0 - hot) == pytest.approx(1 - np.exp(-1), abs=0.02)


@pytest.mark.parametrize("dt", [0.001, 0.0025, 0.005])
def test_a_slow_current_loop_reaches_two_thirds_after_its_time(bench, dt):
    made = bench({"torque_lag": {"time": 0.02}}, inertia=1e6, dt=dt).run(0.2, target=lambda t: 0.1)
    reached = made["t"][np.argmax(made["tau"] > 3.0 * (1 - np.exp(-1)))]
    assert reached == pytest.approx(0.02, abs=dt + 1e-9)
    assert made["tau"][-1] == pytest.approx(3.0, rel=1e-3)


@pytest.mark.parametrize("dt", [0.001, 0.0025, 0.005])
def test_a_velocity_filter_has_two_thirds_of_a_speed_after_its_time(bench, dt):
    made = bench({"velocity_lag": {"time": 0.02}}, kp=0.0, inertia=1e6, dt=dt)
    made.run(dt)
    made.data.qvel[:] = 2.0
    braking = -made.run(0.2)["tau"]
    assert (np.argmax(braking > 6.0 * (1 - np.exp(-1))) + 1) * dt == pytest.approx(0.02, abs=1.5 * dt)
    assert braking[-1] == pytest.approx(6.0, rel=1e-3)


# ---------------------------------------------------------------------- transmission


def test_a_gap_is_crossed_at_each_reversal_before_the_link_follows(bench):
    made = bench({"backlash": {"gap": 0.05}}, inertia=1e4)
    up = made.run(1.0, target=lambda t: 0.1)["reading"][-1]
    down = made.run(1.0, target=lambda t: -0.1)["reading"][-1]
    stiff = 2 * (3.0 - 30 * 0.025) * 2e-4  # what the teeth give way under the torque of either side
    assert up - down == pytest.approx(0.05 + stiff, abs=2e-4)


def test_a_link_behind_a_gap_dwells(bench):
    effects = {"backlash": {"gap": 0.04}, "coulomb": {"level": 0.05}}
    made = bench(effects, kd=1.0)
    made.run(2.0, target=lambda t: 0.2 * t)
    q = made.run(1.0, target=lambda t: 0.4 - 0.2 * (t - 2.0))
    dwell = q["t"][np.abs(q["q"] - q["q"].max()) < 0.002]
    motor = q["reading"][np.searchsorted(q["t"], dwell[0])] - q["reading"][np.searchsorted(q["t"], dwell[-1])]
    assert motor == pytest.approx(0.04, abs=0.008)


def test_an_elastic_joint_gives_way_in_proportion_to_torque(bench):
    made = bench({"compliance": {"compliance": 0.01}}, weight=0.5).run(4.0)
    load = 30 * made["reading"][-1]
    assert abs(load) > 0.3
    assert made["reading"][-1] - made["q"][-1] == pytest.approx(-0.01 * load, rel=0.01)


def test_an_elastic_joint_rings_at_its_own_frequency(bench):
    """The link on the spring, against a motor that is held."""
    made = bench({"compliance": {"compliance": 0.01}}, kp=5000.0, kd=50.0, dt=0.001)
    made.machine.drives.torque[:] = 1e5
    q = made.run(1.0, speed=1.0)
    crossings = q["t"][1:][np.diff(np.sign(q["q"])) != 0]
    assert np.mean(np.diff(crossings)[:4]) == pytest.approx(np.pi * np.sqrt(INERTIA * 0.0102), rel=0.03)


# ---------------------------------------------------------------------- encoder


def test_an_offset_is_in_the_reading_and_moves_the_joint(bench):
    made = bench({"encoder_offset": {"angle": 0.1}}).run(1.0, target=lambda t: 0.3)
    assert (made["reading"][-1], made["q"][-1]) == (pytest.approx(0.3, abs=1e-4), pytest.approx(0.2, abs=1e-4))


def test_a_scale_is_in_the_reading_and_in_the_stiffness(bench):
    made = bench({"encoder_scale": {"factor": 1.25}}).run(1.0, target=lambda t: 0.5)
    assert (made["reading"][-1], made["q"][-1]) == (pytest.approx(0.5, abs=1e-4), pytest.approx(0.4, abs=1e-4))
    stalled = bench({"encoder_scale": {"factor": 1.25}}, inertia=1e6).run(0.05, target=lambda t: 0.1)
    assert stalled["tau"][-1] == pytest.approx(3.0, rel=1e-3)


def test_a_coarse_encoder_reads_steps_and_the_motor_feels_them(bench):
    made = bench({"encoder_step": {"angle": 0.01}}, inertia=1e5)
    made.data.qpos[:] = 0.0137
    assert made.run(0.01)["reading"][-1] == pytest.approx(0.01)
    assert made.run(0.01)["tau"][-1] == pytest.approx(-0.3, rel=1e-3)


# ---------------------------------------------------------------------- forces


def test_a_spring_settles_where_its_pull_is_balanced(bench):
    made = bench({"spring": {"stiffness": 2.0, "moment": 0.5}}, kp=0.0).run(12.0)
    assert made["q"][-1] == pytest.approx(0.25, abs=2e-3)


def test_cogging_comes_back_over_one_tooth(bench):
    law = bench({"cogging": {"cosine": 0.3, "sine": -0.4, "order": 24.0}}).law
    q, none = np.linspace(0, 2 * np.pi / 24, 50), np.zeros((1, 2))
    torque = [law.step(np.full((1, 2), x), none, none, 0.0).applied[0, 0] for x in q]
    assert torque[0] == pytest.approx(0.3)
    assert torque[0] == pytest.approx(torque[-1])
    assert max(torque) == pytest.approx(0.5, rel=0.01)


# ---------------------------------------------------------------------- voltage drives

SERVO = {"drive": "voltage", "gain": 5.0, "voltage": 10.0, "kt": 0.4, "resistance": 4.0}
"""1 N m at rest with full duty, 25 rad/s without a load."""


def test_motor_constants_of_a_drive_that_controls_torque_are_refused(bench):
    with pytest.raises(ConfigError, match="'motor' is of voltage drives"):
        neutral("motor", "kt", bench().machine)


def test_a_voltage_drive_without_its_numbers_is_refused(bench):
    with pytest.raises(ConfigError, match=r"needs gain, voltage, kt, resistance .* kt is None"):
        bench(drive={k: v for k, v in SERVO.items() if k != "kt"})


def test_an_eccentric_encoder_reads_and_is_driven_by_what_it_reads(bench):
    made = bench({"encoder_eccentricity": {"cosine": 0.03, "sine": -0.05}})
    run = made.run(2.0, target=lambda t: 0.5)
    q = run["q"][-1]
    assert run["reading"][-1] == pytest.approx(q + 0.03 * np.cos(q) - 0.05 * np.sin(q), abs=1e-9)
    assert run["reading"][-1] == pytest.approx(0.5, abs=1e-4)


def test_a_filtered_target_arrives_with_its_time_constant(bench):
    made = bench({"target_filter": {"time": 0.2}}, kp=300.0, kd=8.0).run(0.4, target=lambda t: 0.3)
    slow = bench(kp=300.0, kd=8.0).run(0.4, target=lambda t: 0.3 * (1 - np.exp(-(t + 0.00125) / 0.2)))
    assert np.abs(made["q"] - slow["q"]).max() < 2e-3


# ---------------------------------------------------------------------- all of them

ELSEWHERE = ("delay", "joint_delay", "delay_jitter", "lost_commands", "base_tilt", "motor")
"""Effects of the path of commands, of the stand, and of drives that this bench does not have."""

IN_LAW = [name for name in CATALOGUE if name not in ELSEWHERE]


def wave(t: float) -> float:
    return 0.4 * np.sin(9 * t) + (0.3 if t > 0.4 else 0.0)


@pytest.mark.parametrize("name", IN_LAW)
def test_neutral_parameters_change_nothing(bench, name):
    plain = bench().run(1.0, target=wave)
    machine = bench().machine
    values = {p.name: neutral(name, p.name, machine)[0] for p in CATALOGUE[name].parameters}
    made = bench({name: values}).run(1.0, target=wave)
    assert np.ptp(plain["q"]) > 0.3
    assert np.abs(made["q"] - plain["q"]).max() < 2e-5  # a lag is never shorter than 0.1 microseconds


LARGE = {
    "coulomb": {"level": 2.0},
    "viscous": {"coefficient": 5.0},
    "link_mass": {"factor": 0.3},
    "armature": {"inertia": 0.0},
    "gains": {"kp": 3.0, "kd": 4.0},
    "torque_speed": {"torque": 1.0, "speed": 3.0, "flat": 0.0},
    "supply_sag": {"drop": 0.1},
    "kt_gain": {"factor": 3.0},
    "kt_drift": {"rate": 2.0},
    "kt_heat": {"loss": 0.5, "time": 5.0},
    "torque_lag": {"time": 0.005},
    "velocity_lag": {"time": 0.005},
    "stribeck": {"level": 3.0, "speed": 0.005},
    "load_friction": {"ratio": 0.9},
    "gear_load_friction": {"ratio": 0.9},
    "asymmetric_friction": {"level": 0.5, "coefficient": 0.05},
    "quadratic_drag": {"coefficient": 0.05},
    "coupling": {"coefficient": 0.1},
    "backlash": {"gap": 0.3},
    "compliance": {"compliance": 0.05},
    "encoder_offset": {"angle": 0.5},
    "encoder_scale": {"factor": 1.5},
    "encoder_step": {"angle": 0.02},
    "cogging": {"cosine": 1.0, "sine": 1.0, "order": 30.0},
    "spring": {"stiffness": 5.0, "moment": 1.0},
    "payload": {"mass": 1.0},
    "com_shift": {"distance": 0.05},
    "encoder_eccentricity": {"cosine": 0.05, "sine": 0.05},
    "target_filter": {"time": 0.05},
}


@pytest.mark.parametrize("name", IN_LAW)
def test_large_effects_are_stable_at_steps_of_5_ms(bench, name):
    """A link as light as the robot's lower leg goes to its target; nothing grows."""
    made = bench({name: LARGE[name]}, inertia=0.005, dt=0.005).run(3.0, target=lambda t: 0.3 if t < 1 else 0.0)
    assert np.abs(made["dq"]).max() < 30.0
    late = made["t"] > 2.5
    assert np.abs(made["q"][late]).max() < 0.8
    assert np.abs(made["dq"][late]).max() < 4.0


@pytest.mark.train
def test_numpy_and_pytorch_are_the_same_law(bench):
    torch = pytest.importorskip("torch", reason="training needs the extra 'train'")
    made = bench({name: LARGE[name] for name in IN_LAW})
    law, d = made.law, made.machine.drives

    def tensor(value):
        return torch.as_tensor(np.asarray(value))

    p = {key: tensor(value) for key, value in law._p.items()}
    names = ("kp", "kd", "torque", "flat", "speed", "friction", "armature", "neighbour")
    other = Law(replace(d, **{n: tensor(getattr(d, n)) for n in names}), p, law.dt, (1, 2), torch)
    rng = np.random.default_rng(0)
    start = rng.normal(size=(2, 1, 2))
    law.begin(*start)
    other.begin(*map(tensor, start))
    for k in range(200):
        q, dq, target, after = rng.normal(size=(4, 1, 2)) * np.array([0.3, 5.0, 0.5, 5.0])[:, None, None]
        one, two = law.step(q, dq, target, k * law.dt), other.step(tensor(q), tensor(dq), tensor(target), k * law.dt)
        for name in ("torque", "inertia", "friction", "applied", "tau"):
            mine, yours = getattr(one, name), getattr(two, name).numpy()
            assert np.abs(mine - yours).max() <= 1e-12 * max(1.0, np.abs(mine).max())
        law.settle(after)
        other.settle(tensor(after))
        assert np.abs(law.reading(q) - other.reading(tensor(q)).numpy()).max() < 1e-12
