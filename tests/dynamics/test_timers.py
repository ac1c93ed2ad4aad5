from __future__ import annotations

import subprocess
import sys

SCRIPT = """
import mujoco
import numpy as np
from mimic.dynamics.timers import disable_timers

model = mujoco.MjModel.from_xml_string(
    '<mujoco><worldbody><body><joint/><geom size="0.1" pos="0.2 0 0"/></body></worldbody></mujoco>'
)

def played():
    data = mujoco.MjData(model)
    data.qvel[:] = 1.0
    for _ in range(50):
        mujoco.mj_step(model, data)
    return data.qpos.copy(), data.timer[mujoco.mjtTimer.mjTIMER_STEP].duration

timed, before = played()
assert before > 0.0, before
assert disable_timers()
untimed, after = played()
assert after == 0.0, after
assert np.array_equal(timed, untimed)
"""


def test_steps_are_no_longer_timed_and_nothing_else_changes():
    subprocess.run([sys.executable, "-c", SCRIPT], check=True)
