"""A whole calibration on a small arm: truth is found, nothing is invented."""

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter
from threadpoolctl import threadpool_info

from lab.hidden_effects import planar_arm
from mimic.config.sysid import CalibrateSettings, LogSettings
from mimic.dynamics.catalogue import CATALOGUE, UnknownEffect
from mimic.dynamics.effect_set import EffectSet, EffectValues
from mimic.dynamics.machine import MachineModel, read_machine, with_gains
from mimic.errors import CalibrationError
from mimic.io.joint_log import JointLog
from mimic.sysid.calibrate import calibrate
from mimic.sysid.predict import simulate_log
from mimic.sysid.result import Calibration

ARM = """
<mujoco>
  <option timestep="0.001"/>
  <worldbody>
    <body name="upper" pos="0 0 1">
      <joint name="shoulder" axis="0 1 0" armature="0.003" damping="0.04" frictionloss="0.05"/>
      <inertial pos="0 0 -0.06" mass="0.5" diaginertia="0.001 0.001 0.0003"/>
      <body name="lower" pos="0 0 -0.12">
        <joint name="elbow" axis="0 1 0" armature="0.003" damping="0.04" frictionloss="0.05"/>
        <inertial pos="0 0 -0.09" mass="0.2" diaginertia="0.0008 0.0008 0.0001"/>
        <site name="tip" pos="0 0 -0.18"/>
      </body>
    </body>
  </worldbody>
</mujoco>
"""

BASELINE = (
    EffectValues(name="coulomb", joints=("shoulder", "elbow"), values={"level": np.array([0.09, 0.04])}),
    EffectValues(name="viscous", joints=("shoulder", "elbow"), values={"coefficient": np.array([0.07, 0.03])}),
    EffectValues(name="link_mass", joints=("shoulder", "elbow"), values={"factor": np.array([1.05, 0.93])}),
    EffectValues(name="delay", values={"time": np.array([0.011])}),
)


TRIED = ("stribeck", "torque_speed", "spring", "load_friction")


@pytest.fixture(scope="module")
def arm(tmp_path_factory: pytest.TempPathFactory) -> MachineModel:
    path = tmp_path_factory.mktemp("arm") / "arm.xml"
    path.write_text(ARM)
    return read_machine(path, {"kp": 20.0, "kd": 0.8})


def targets(seconds: float = 11.0, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Sines of several speeds, holds, and steps at 50 Hz."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, seconds, 0.02)
    phase = rng.uniform(0, 2 * np.pi, (6, 2))
    rates = (0.13, 0.31, 0.7, 1.3, 2.2, 3.7)
    q = sum((0.5 / (1 + k)) * np.sin(2 * np.pi * f * t[:, None] + phase[k]) for k, f in enumerate(rates))
    steps = np.repeat(rng.uniform(-0.5, 0.5, (len(t) // 40 + 1, 2)), 40, axis=0)[: len(t)]
    return t, np.where((t % 10 > 7)[:, None], steps, q)


def log_of(arm: MachineModel, *hidden: EffectValues, seed: int = 1) -> JointLog:
    t, q_des = targets(seed=seed)
    made = simulate_log(arm, t, q_des, EffectSet((*BASELINE, *hidden)), LogSettings(seed=seed, timestep=0.001))
    return replace(made, tau=None)


@cache
def clean_log(arm: MachineModel) -> JointLog:
    """The log of an arm that has the baseline effects only."""
    return log_of(arm)


def settings(**values: Any) -> CalibrateSettings:
    return CalibrateSettings(**{"threads": 1, **values})


def both(name: str, **values: float) -> EffectValues:
    return EffectValues(
        name=name, joints=("shoulder", "elbow"), values={k: np.array([v, v]) for k, v in values.items()}
    )


@cache
def clean_result(arm: MachineModel) -> Calibration:
    return calibrate(clean_log(arm), arm, settings())


@cache
def bare_result(arm: MachineModel) -> Calibration:
    return calibrate(clean_log(arm), arm, settings(most_effects=0))


@pytest.mark.slow
def test_nothing_is_added_to_a_machine_that_lacks_nothing(arm: MachineModel) -> None:
    result = clean_result(arm)
    assert result.names == ()
    assert "lacks nothing" in result.sentence
    assert all(r.explained for r in result.unexplained)


@pytest.mark.slow
def test_the_baseline_parameters_are_found_within_their_intervals(arm: MachineModel) -> None:
    found = {e.name: e for e in clean_result(arm).effects}
    for truth in BASELINE:
        for name, value in truth.values.items():
            interval = found[truth.name].intervals[name]
            wider = 1.5 * (interval[:, 1] - interval[:, 0])
            assert np.all(np.abs(found[truth.name].values[name] - value) < np.maximum(wider, 1e-4)), (truth.name, name)


def test_the_error_falls_to_the_noise_floor_on_blocks_that_were_not_used(arm: MachineModel) -> None:
    result = clean_result(arm)
    assert np.all(result.nominal.held_out > 3 * result.noise)
    assert np.all(result.final.held_out < 1.15 * result.noise)


def test_many_short_logs_are_one_data_set(arm: MachineModel) -> None:
    log = clean_log(arm)
    rows = len(log.t) // 12
    parts = [log.part(slice(k * rows, (k + 1) * rows)) for k in range(12)]
    result = calibrate(parts, arm, settings(most_effects=0))
    assert result.log_matches_model
    found = {e.name: e for e in result.effects}
    for one in BASELINE[:2]:
        for name, value in one.values.items():
            np.testing.assert_allclose(found[one.name].values[name], value, rtol=0.15)
    with pytest.raises(CalibrationError, match=r"lasts 3\.\d\d s .* 5 s are needed"):
        calibrate(parts[:4], arm, settings(most_effects=0))


@pytest.mark.slow
@pytest.mark.parametrize(
    "hidden",
    [
        both("stribeck", level=0.12, speed=0.15),
        both("torque_speed", torque=1.6, speed=7.0, flat=0.0),
    ],
    ids=lambda e: e.name,
)
def test_a_hidden_effect_is_named_with_its_numbers(arm: MachineModel, hidden: EffectValues) -> None:
    result = calibrate(log_of(arm, hidden), arm, settings(effects=TRIED))
    assert result.names == (hidden.name,)
    found = next(e for e in result.effects if e.name == hidden.name)
    assert set(hidden.joints) <= set(found.joints)
    for name, value in hidden.values.items():
        got = np.array([found.values[name][found.joints.index(j)] for j in hidden.joints])
        assert got == pytest.approx(value, rel=0.25, abs=0.02), name
    assert np.all(result.final.held_out < 1.2 * result.noise)


@pytest.mark.slow
def test_gains_of_one_joint_are_reported_in_that_joint(arm: MachineModel) -> None:
    stiff = {"kp": np.array([1.3]), "kd": np.array([1.0])}
    hidden = EffectValues(name="gains", joints=("shoulder",), values=stiff)
    result = calibrate(log_of(arm, hidden), arm, settings(effects=("gains",)))
    assert [(one.name, one.joints) for one in result.found] == [("gains", ("shoulder",))]
    gains = next(e for e in result.effects if e.name == "gains")
    low, high = gains.intervals["kp"][0]
    assert low < 1.3 < high


@pytest.mark.slow
def test_targets_in_another_order_do_not_belong_to_the_log(arm: MachineModel) -> None:
    log = clean_log(arm)
    assert log.q_des is not None
    shuffled = np.random.default_rng(0).permutation(len(log.t) // 40)
    order = np.concatenate([np.arange(40) + 40 * i for i in shuffled])
    result = calibrate(replace(log.part(slice(0, len(order))), q_des=log.q_des[order]), arm, settings())
    assert not result.log_matches_model
    assert result.names == ()
    assert "does not match the model" in result.sentence


@pytest.mark.slow
def test_with_no_effects_to_add_none_is_said_to_be_looked_for(arm: MachineModel) -> None:
    result = bare_result(arm)
    assert result.sentence.startswith("The baseline parameters were fitted")
    assert "No missing effects were searched for" in result.sentence


def test_effects_that_do_not_exist_are_reported_before_anything_is_fitted(arm: MachineModel) -> None:
    told: list[str] = []
    for wrong in (settings(effects=("stribek",)), settings(baseline=("coulom",))):
        with pytest.raises(UnknownEffect, match="coulomb, viscous"):
            calibrate(clean_log(arm), arm, wrong, lambda text, replays: told.append(text))
    assert not told


def test_linear_algebra_runs_in_one_thread_meanwhile(arm: MachineModel) -> None:
    """Threads that wait for each other on a busy computer take longer than the small systems here."""

    def threads() -> list[int]:
        return [library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"]

    def tell(text: str, replays: int) -> None:
        seen.extend(threads())
        raise KeyboardInterrupt

    seen: list[int] = []
    before = threads()
    with pytest.raises(KeyboardInterrupt):
        calibrate(clean_log(arm), arm, settings(), tell)
    assert set(seen) == {1}
    assert threads() == before


@pytest.mark.slow
def test_nothing_is_fitted_to_a_joint_that_never_moves(arm: MachineModel) -> None:
    """Its reading has no noise, and would count more than all others."""
    log = clean_log(arm)
    still = replace(log, q=np.where([True, False], 0.1, log.q), q_des=np.where([True, False], 0.1, log.q_des))
    result = calibrate(still, arm, settings(most_effects=0))
    assert {e.joints for e in result.effects} == {("elbow",), ()}


@pytest.mark.slow
def test_a_log_of_forces_is_replayed_without_a_servo(arm: MachineModel) -> None:
    """Whatever gains the model has: there are no targets that they could pull to."""
    log = clean_log(arm)
    forces = JointLog(joints=log.joints, t=log.t, q=log.q, force=0.05 * np.sin(3.0 * log.t)[:, None] + 0.0 * log.q)
    free = calibrate(forces, with_gains(arm, {"kp": 0.0, "kd": 0.0}), settings(most_effects=0))
    held = calibrate(forces, arm, settings(most_effects=0))
    assert np.array_equal(free.nominal.held_out, held.nominal.held_out)


@pytest.mark.slow
def test_a_bound_that_means_none_is_no_warning(arm: MachineModel) -> None:
    """A drive that brakes less than its gains say asks for less than no friction."""
    log = clean_log(arm)
    stiffer = replace(log, metadata={**log.metadata, "kd": {"shoulder": 1.2, "elbow": 0.8}})
    made = calibrate(stiffer, arm, settings(most_effects=0))
    assert next(e for e in made.effects if e.name == "viscous").values["coefficient"][0] == 0.0
    assert made.warnings == clean_result(arm).warnings == ()


@pytest.mark.slow
def test_the_same_log_gives_the_same_answer(arm: MachineModel) -> None:
    again = calibrate(clean_log(arm), arm, settings(most_effects=0))
    assert again.sentence == bare_result(arm).sentence
    for one, other in zip(again.effects, bare_result(arm).effects, strict=True):
        for name, value in one.values.items():
            assert np.array_equal(value, other.values[name])


@pytest.mark.slow
def test_a_number_at_a_bound_of_its_validity_is_reported_beside_the_name(arm: MachineModel, monkeypatch) -> None:
    """The bound says how large a number may be, and nothing against the effect."""
    stiff = EffectValues(
        name="spring", joints=("elbow",), values={"stiffness": np.array([0.5]), "moment": np.array([0.0])}
    )
    log = log_of(arm, stiff)
    spec = CATALOGUE["spring"]
    narrow = tuple(replace(p, high=0.4) if p.name == "stiffness" else p for p in spec.parameters)
    monkeypatch.setitem(CATALOGUE, "spring", replace(spec, parameters=narrow))
    result = calibrate(log, arm, settings(effects=("spring",), most_effects=1))
    assert result.names == ("spring",)
    assert next(e for e in result.effects if e.name == "spring").joints == ("elbow",)
    assert any("spring.stiffness of elbow is at its largest, 0.4" in line for line in result.warnings)


COARSE = (
    both("encoder_step", angle=0.006),
    EffectValues(name="armature", joints=("elbow",), values={"inertia": np.array([0.012])}),
)
"""An encoder that rounds, and what hides below that."""


@pytest.fixture(scope="module")
def coarse(arm: MachineModel) -> Calibration:
    """Calibrate from a log with COARSE."""
    chosen = settings(effects=("encoder_step", "armature", "stribeck", "joint_delay"))
    return calibrate(log_of(arm, *COARSE), arm, chosen)


@pytest.mark.slow
def test_what_a_coarse_encoder_rounds_off_is_noise_to_all_else(coarse: Calibration) -> None:
    """Its step is read off; numbers are fitted without it, and what hides below it is still found."""
    assert coarse.names == ("armature", "encoder_step")
    effects = {e.name: e for e in coarse.effects}
    assert effects["encoder_step"].values["angle"] == pytest.approx([0.006, 0.006], rel=1e-3)
    assert coarse.noise == pytest.approx(np.hypot(0.35e-3, 0.006 / np.sqrt(12.0)), rel=0.15)
    assert all(r.explained for r in coarse.unexplained)


@pytest.mark.slow
def test_with_a_coarse_encoder_intervals_hold_the_truth(coarse: Calibration) -> None:
    effects = {e.name: e for e in coarse.effects}
    off = []
    for true in (*BASELINE, COARSE[1]):
        found = effects[true.name]
        for name, row in found.intervals.items():
            where = [found.joints.index(j) for j in true.joints] or [0]
            half = (row[where, 1] - row[where, 0]) / 2.0
            off += list(1.96 * (found.values[name][where] - true.values[name]) / half)
    assert np.max(np.abs(off)) < 4.0
    assert np.mean(np.abs(off)) < 1.6


def test_targets_that_never_arrived_are_found(arm: MachineModel) -> None:
    """One in 25, among them some that follow each other; their share is told, and the rest is noise."""
    (t, q_des) = targets(12.0)
    hidden = EffectValues(name="lost_commands", values={"share": np.array([0.04])})
    log = simulate_log(arm, t, q_des, EffectSet((*BASELINE, hidden)), LogSettings(seed=2, timestep=0.001))
    result = calibrate(log, arm, settings(effects=("lost_commands",)))
    assert result.names == ("lost_commands",)
    assert result.found[0].share > 0.9
    effects = {e.name: e for e in result.effects}
    low, high = effects["lost_commands"].intervals["share"][0]
    assert low < 0.04 < high
    assert all(r.explained for r in result.unexplained)


def test_a_delay_of_its_own_for_each_target_is_found(arm: MachineModel) -> None:
    hidden = EffectValues(name="delay_jitter", values={"spread": np.array([0.012])})
    result = calibrate(log_of(arm, hidden), arm, settings(effects=("delay_jitter", "lost_commands")))
    assert result.names == ("delay_jitter",)
    effects = {e.name: e for e in result.effects}
    assert effects["delay_jitter"].values["spread"][0] == pytest.approx(0.012, rel=0.2)
    assert effects["delay"].values["time"][0] == pytest.approx(0.011, abs=0.002)
    assert all(r.explained for r in result.unexplained)


@pytest.mark.slow
def test_a_torque_that_wanders_slowly_is_called_nothing(arm: MachineModel) -> None:
    """Forgotten after 3 s, it looks like a constant torque over much of a log: a difference of friction."""
    (t, q_des), keep = targets(22.0), np.exp(-0.02 / 3.0)
    kicks = np.sqrt(1 - keep**2) * np.random.default_rng(0).standard_normal(len(t) + 500)
    torque = np.stack([0.3 * lfilter([1.0], [1.0, -keep], kicks)[500:], np.zeros(len(t))], -1)
    pushed = q_des + torque / arm.drives.kp  # as a torque from outside does
    made = simulate_log(arm, t, pushed, EffectSet(BASELINE), LogSettings(seed=0, timestep=0.001))
    row = np.searchsorted(t, made.t + 1e-9, side="right") - 1
    log = replace(made, q_des=q_des[row], tau=None)
    result = calibrate(log, arm, settings(effects=("asymmetric_friction",)))
    assert result.names == ()
    assert not result.explained
    shoulder, elbow = result.unexplained
    assert elbow.explained
    assert not shoulder.explained
    assert shoulder.torque == pytest.approx(0.3, rel=0.4)
    assert "time" in dict(shoulder.depends_on)


@pytest.mark.slow
def test_a_tilted_stand_is_told_beside_an_offset_of_an_encoder(tmp_path) -> None:
    """In a plane a tilt moves all joints as an offset of the first encoder does; here by 3 degrees."""
    log = planar_arm.arm_log(planar_arm.CLOCKS["grid"], seconds=24.0, seed=3)
    turned = np.array([0.06, 0.0])
    log = replace(log, q=log.q + turned, q_des=log.q_des + turned)
    result = calibrate(log, planar_arm.arm_model(tmp_path), CalibrateSettings(threads=1))
    others = {name for one in result.alternatives for name, _ in one.effects}
    assert {"encoder_offset", "base_tilt"} <= {*result.names, *others}
    assert len(result.names) == 1
    assert "encoder offset" in result.sentence
    assert "tilted base" in result.sentence
    assert "base_tilt" in str(result.to_json()["alternatives"]) + str(result.to_json()["found"])
