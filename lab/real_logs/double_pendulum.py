"""DFKI's double pendulum, logged by its torques: what calibration finds in three logs, and predicts in the others.

    python -m lab.real_logs.double_pendulum FOLDER

FOLDER has recordings as NUMBER.csv, 00 to 05, of design C.0: time [s], positions, velocities [rad, rad/s] and torques
[N m] of both joints. Fitted are 00, 01, 03; one second ahead is judged on 02, 04, 05. Source of recordings, masses and
lengths: dfki-ric-underactuated-lab/double_pendulum, BSD-3-Clause, fetched by hand.
"""

from __future__ import annotations

import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from mimic.config.sysid import CalibrateSettings
from mimic.dynamics.effect_set import EffectSet
from mimic.dynamics.machine import MachineModel, as_logged, read_machine
from mimic.io.joint_log import JointLog
from mimic.records import FloatArray
from mimic.sysid.calibrate import calibrate
from mimic.sysid.engine.data import data_of
from mimic.sysid.log.checks import check_log
from mimic.sysid.predict import predict

JOINTS = ("shoulder", "elbow")
FITTED = ("00", "01", "03")
UNSEEN = ("02", "04", "05")

STEP = 0.004
"""Rows are interpolated to this period; the recordings have about 3.5 ms [s]."""

AHEAD = (0.9, 1.1)
"""Errors so long after a prediction began are judged [s]."""

MJCF = """<mujoco model="double_pendulum">
  <worldbody>
    <body name="upper">
      <joint name="shoulder" axis="0 1 0" damping="0.005" frictionloss="0.05" armature="0.0023"/>
      <inertial pos="0 0 -0.2" mass="0.5476" diaginertia="0.0023 0.0023 0.0005"/>
      <body name="lower" pos="0 0 -0.2">
        <joint name="elbow" axis="0 1 0" damping="0.005" frictionloss="0.05" armature="0.0023"/>
        <inertial pos="0 0 -0.275" mass="0.5979" diaginertia="0.0082 0.0082 0.0005"/>
        <site pos="0 0 -0.3"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <motor joint="shoulder"/>
    <motor joint="elbow"/>
  </actuator>
</mujoco>
"""


def pendulum() -> MachineModel:
    """Return the machine; its friction is a guess, for the calibration to find."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "double_pendulum.xml"
        path.write_text(MJCF)
        return read_machine(path)


def read_recording(path: Path) -> JointLog:
    """Return a recording at even times; rows that come within 0.01 ms of the one before are left out."""
    rows = np.genfromtxt(path, delimiter=",", names=True)
    rows = rows[np.append(True, np.diff(rows["time"]) > 1e-5)]
    t = np.arange(0.0, rows["time"][-1], STEP)

    def of(name: str) -> FloatArray:
        return np.stack([np.interp(t, rows["time"], rows[f"{name}{joint}"]) for joint in (1, 2)], axis=-1)

    return check_log(JointLog(joints=JOINTS, t=t, q=of("pos_meas"), force=of("tau_meas"), metadata={})).log


def error_ahead(log: JointLog, machine: MachineModel, effects: EffectSet) -> FloatArray:
    """Return the error of positions one second ahead (2,) [rad], root mean square."""
    logged = as_logged(machine, log.metadata, by_force=True)
    data = data_of([log], logged)
    errors = predict(log, logged, effects)
    begins = np.append(0, np.flatnonzero(np.diff(data.block) > 0) + 1)
    since = data.record.t - data.record.t[begins][data.block]
    judged = (since > AHEAD[0]) & (since < AHEAD[1]) & (data.block > 0)
    return np.sqrt(np.nanmean(np.square(errors[judged]), axis=0))


def main() -> int:
    folder = Path(sys.argv[1])
    machine = pendulum()
    made = calibrate([read_recording(folder / f"{name}.csv") for name in FITTED], machine, CalibrateSettings(threads=1))
    print(made.sentence)
    for effect in made.effects:
        print(
            effect.name, effect.joints, {name: np.round(values, 4).tolist() for name, values in effect.values.items()}
        )
    for name in UNSEEN:
        log = read_recording(folder / f"{name}.csv")
        for what, effects in (("as given", EffectSet()), ("calibrated", made.effects)):
            print(name, what, np.round(1e3 * error_ahead(log, machine, effects)), "mrad")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
