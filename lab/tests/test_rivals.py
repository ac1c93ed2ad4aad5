from __future__ import annotations

import importlib.util
import math
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("numba")

from lab.rivals.__main__ import error_of, named, run, table
from lab.rivals.cases import leg_case
from lab.rivals.methods import METHODS, as_given, of_baseline, of_mujoco, of_sindy
from lab.rivals.torque import motions_of
from mimic.dynamics.machine import read_machine
from mimic.io.joint_log import JointLog


def verdict(names: tuple[str, ...] | None, hidden: tuple[str, ...]) -> str:
    return named({"names": names, "hidden": hidden})


def test_names_are_judged_by_what_is_hidden():
    assert verdict(None, ("spring",)) == "names nothing by design"
    assert verdict((), ()) == "nothing (right)"
    assert verdict((), ("spring",)) == "nothing (missed)"
    assert verdict(("spring",), ("spring",)) == "spring (right)"
    assert verdict(("spring", "cogging"), ("spring",)) == "spring, cogging (right, with 1 more)"
    assert verdict(("cogging",), ("spring",)) == "cogging (wrong)"
    assert verdict(("load_friction",), ()) == "load friction (wrong)"


def test_a_table_has_a_row_for_each_method_and_says_what_could_not_run():
    row = {"case": "leg", "unit": "mrad", "floor": 0.4, "names": None, "hidden": (), "replays": 7}
    rows = [
        {**row, "method": "a", "error": 1.234, "cpu_seconds": 5.0},
        {"case": "leg", "unit": "mrad", "floor": 0.4, "method": "b", "why_not": "no library"},
    ]
    lines = table(rows).splitlines()
    assert "| a | names nothing by design | 1.23 | 5.0 s | 7 |" in lines
    assert any(line.startswith("| b | not run: no library") for line in lines)


@pytest.mark.slow
def test_the_regression_and_the_baseline_fit_predict_an_unseen_motion_better_than_the_model_as_given():
    case = leg_case("single/stribeck/medium/probe/0/20s/grid/leg")
    assert not np.array_equal(case.test.q[:100], case.fitted[0].q[:100])
    before = error_of(case, as_given(case))
    sparse, baseline = of_sindy(case), of_baseline(case)
    assert error_of(case, sparse) < 0.5 * before
    assert error_of(case, baseline) < 0.5 * before
    assert "stribeck" in (sparse.names or ())


@pytest.mark.slow
def test_mujoco_sysid_fits_the_leg_or_says_what_is_missing():
    case = leg_case("clean/nothing/none/probe/1/10s/grid/leg")
    if importlib.util.find_spec("tabulate") is None:
        row = run(case, "mujoco.sysid")
        assert "pip install" in row["why_not"]
        return
    found = of_mujoco(case)
    assert error_of(case, found) < 0.1 * error_of(case, as_given(case))


def test_torques_show_the_delay_of_the_targets(tmp_path: Path):
    """A pendulum that is simulated here, step by step."""
    mass, length, rotor, delay, step = 0.8, 0.15, 0.004, 0.006, 5e-4
    (tmp_path / "pendulum.xml").write_text(
        f'<mujoco><worldbody><body><joint name="j" axis="0 1 0" armature="{rotor}"/><inertial pos="0 0 -{length}"'
        f' mass="{mass}" diaginertia="1e-4 1e-4 1e-4"/></body></worldbody></mujoco>'
    )
    sent = np.arange(0.0, 16.0, 0.02)
    goals = sum(0.5 / (1 + k) * np.sin(2 * np.pi * f * sent + k) for k, f in enumerate((0.3, 0.8, 1.7, 3.1)))
    q, v, rows, inertia = goals[0], 0.0, [], mass * length**2 + 1e-4 + rotor
    for i in range(round(sent[-1] / step)):
        if i % 10 == 0:
            rows.append((i * step, q, goals[i // 40]))
        tau = 30.0 * (goals[max(int((i * step - delay) / 0.02 + 1e-6), 0)] - q) - 0.8 * v
        free = v + step * (tau - 0.03 * v - mass * 9.81 * length * math.sin(q)) / inertia
        v = math.copysign(max(abs(free) - step * 0.12 / inertia, 0.0), free)
        q += step * v
    t, reading, target = np.array(rows).T
    reading = reading + 3e-4 * np.random.default_rng(0).standard_normal(len(t))
    log = JointLog(joints=("j",), t=t, q=reading[:, None], q_des=target[:, None], metadata={"kp": 30.0, "kd": 0.8})
    found, (motion,) = motions_of([(log, read_machine(tmp_path / "pendulum.xml"))])
    assert found == pytest.approx(delay, abs=1e-3)
    friction = motion.filtered(motion.tau - motion.need - 0.03 * motion.dq)[motion.moving[:: motion.every]]
    assert np.median(np.abs(friction)) == pytest.approx(0.12, abs=0.02)


def test_every_method_has_a_name_of_its_own():
    assert len({f.__name__ for f in METHODS.values()}) == len(METHODS)
