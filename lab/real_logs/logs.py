"""Public logs of real machines as logs and models that ``mimic calibrate`` takes.

    python -m lab.real_logs.logs ../shared/data/logs OUT

writes OUT/emps.parquet, emps_pulses.parquet, emps.xml, go2.parquet, its halves go2_first and go2_second.parquet,
go2.xml, four servo_MOTION.parquet and servo.xml, eight xl330_NAME.parquet and xl330.xml, and prints what the EMPS data
say about their own controller and how well the published parameters replay in closed loop.

EMPS: a DC motor and a ball screw at 1 kHz. Source: Janot, Gautier, Brunot, Data Set and Reference Models of EMPS, 2019.
Go2: a Unitree Go2 hung up, at 200 Hz. Source: iit-DLSLab/sim2real-robot-identification, BSD-3-Clause.
STS3250: a pendulum on a hobby servo, four motions of 6 s at about 47 Hz. Source: Rhoban/bam, data_raw_feetech,
Apache-2.0.
XL330: the same for a Dynamixel XL330, a voltage drive, at 150 to 290 Hz and two gains. Source: Rhoban/bam,
data.bak/raw, Apache-2.0.
"""

from __future__ import annotations

import argparse
import json
import shutil
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq

from mimic.io.joint_log import JointLog, write_log
from mimic.records import FloatArray

FORCE = 35.15
"""Force of the motor at the carriage for each volt of the drive [N/V]."""
TICK = 0.001
"""Period of the EMPS controller [s]."""

PUBLISHED = {"mass": 95.1089, "viscous": 203.5034, "coulomb": 20.3935, "offset": -3.1648}
"""Symmetric model [kg, N s/m, N, N]."""
ASYMMETRIC = {"mass": 95.1540, "viscous": (166.7061, 240.4236), "coulomb": (20.1440, 20.6277), "offset": 0.0}
"""The same for motion forward and backward."""
CLOSED_LOOP = {"DATA_EMPS": (0.013752, 0.22911), "DATA_EMPS_PULSES": (0.0080248, 0.47888)}
"""Published relative error of position and velocity of the symmetric model [%]."""

EMPS_MJCF = """<mujoco model="emps">
  <!-- A carriage on a ball screw. Mass as one would weigh it; friction is for the calibration to find. -->
  <compiler angle="radian"/>
  <option gravity="0 0 -9.81" timestep="0.001"/>
  <worldbody>
    <body name="carriage">
      <inertial pos="0 0 0" mass="95" diaginertia="1 1 1"/>
      <joint name="slide" type="slide" axis="1 0 0" damping="100" frictionloss="10"/>
    </body>
  </worldbody>
  <actuator>
    <motor name="slide" joint="slide"/>
  </actuator>
</mujoco>
"""


SERVO_GAINS = {"kp": 67.3, "kd": 2.35}
"""Of the STS3250 as Rhoban/bam fitted them [N m/rad, N m s/rad]: its register does not say what they are."""

SERVO_MJCF = """<mujoco model="servo">
  <!-- The pendulum of the STS3250: 1.13 kg at 0.12 m. What the servo gives at most is for the calibration to find. -->
  <worldbody>
    <body name="arm" pos="0 0 1">
      <joint name="j" axis="0 1 0" armature="0.005"/>
      <inertial pos="0 0 -0.12" mass="1.13" diaginertia="1e-3 1e-3 1e-3"/>
    </body>
  </worldbody>
  <actuator><position joint="j" kp="1" forcerange="-9 9"/></actuator>
</mujoco>
"""


XL330_MJCF = """<mujoco model="xl330">
  <!-- A pendulum of 0.49 kg at 0.1 m on a Dynamixel XL330. What the motor gives is in the notes of the logs. -->
  <worldbody>
    <body name="arm" pos="0 0 1">
      <joint name="j" axis="0 1 0" armature="0.005"/>
      <inertial pos="0 0 -0.1" mass="0.49" diaginertia="4e-4 4e-4 4e-4"/>
    </body>
  </worldbody>
</mujoco>
"""

XL330_MOTOR = {"kt": 0.35, "resistance": 4.0}
"""Guesses, which the calibration corrects [N m/A, ohm]."""

DUTY = 4096 / (2 * np.pi) / (256 * 885)
"""Duty for each radian and unit of the gain register of the XL330. Source: README of the data."""


@dataclass(frozen=True, kw_only=True)
class Cascade:
    """Controller of the EMPS: volts = kv (kp (target - position) - velocity) + share of the added voltage."""

    kp: float
    """[1/s]"""
    kv: float
    """[V s/m]"""
    added: float
    """Volts for each volt of the pulses; 0 without."""
    left: float
    """Share of the voltage that it does not explain."""


def read_emps(path: Path) -> dict[str, FloatArray]:
    """Return the columns of an EMPS file, and the volts of the pulses (0 without)."""
    table = pq.read_table(path)
    columns = {name: table[name].to_numpy().astype(np.float64) for name in table.column_names}
    return {"pulses_N": np.zeros(table.num_rows), **columns}


def late_speed(q: FloatArray) -> FloatArray:
    """Return the mean speed over the last two periods, which is one period late; the first two rows are 0."""
    return np.concatenate([[0.0, 0.0], (q[2:] - q[:-2]) / (2 * TICK)])


def identify(columns: dict[str, FloatArray]) -> Cascade:
    """Fit the gains of the controller to the voltage, by least squares."""
    parts = [columns["qg"] - columns["qm"], -late_speed(columns["qm"]), columns["pulses_N"]]
    matrix, volts = np.stack(parts, -1)[5:], columns["vir"][5:]
    there = matrix.any(axis=0)
    x = np.zeros(3)
    x[there] = np.linalg.lstsq(matrix[:, there], volts, rcond=None)[0]
    left = float(np.linalg.norm(volts - matrix @ x) / np.linalg.norm(volts))
    return Cascade(kp=x[0] / x[1], kv=x[1], added=x[2], left=left)


def replay(columns: dict[str, FloatArray], model: dict, gains: Cascade, substeps: int = 5) -> tuple[FloatArray, ...]:
    """Return position, velocity and force of the model in closed loop, from the first reading on.

    The controller runs each millisecond and holds its force; dry friction is implicit.
    """
    forward_back = {k: np.broadcast_to(np.asarray(v, dtype=float), 2) for k, v in model.items()}
    mass, offset = float(forward_back["mass"][0]), float(forward_back["offset"][0])
    (fv, bv), (fc, bc) = forward_back["viscous"].tolist(), forward_back["coulomb"].tolist()
    target, pulses, qm = columns["qg"].tolist(), columns["pulses_N"].tolist(), columns["qm"].tolist()
    x, v, h = qm[0], (qm[1] - qm[0]) / TICK, TICK / substeps
    rows: list[tuple[float, float, float]] = []
    for i, (goal, pulse) in enumerate(zip(target, pulses, strict=True)):
        seen = (x - rows[i - 2][0]) / (2 * TICK) if i > 1 else v
        force = FORCE * (gains.kv * (gains.kp * (goal - x) - seen) + gains.added * pulse)
        rows.append((x, v, force))
        for _ in range(substeps):
            push = force - offset
            ahead = v > 0 or (v == 0 and push > 0)
            free = (v + h * push / mass) / (1 + h * (fv if ahead else bv) / mass)
            brake = h * (fc if ahead else bc) / mass
            v = np.sign(free) * max(abs(free) - brake, 0.0)
            x += h * v
    return tuple(np.array(rows).T)


def emps_log(columns: dict[str, FloatArray], gains: Cascade) -> JointLog:
    """Return an EMPS file as a log of a position drive in newtons, with the pulses as a force added to it."""
    pulses = columns["pulses_N"][:, None]
    return JointLog(
        joints=("slide",),
        t=columns["t"],
        q=columns["qm"][:, None],
        q_des=columns["qg"][:, None],
        force=FORCE * gains.added * pulses if pulses.any() else None,
        tau=FORCE * np.concatenate([columns["vir"][:1], columns["vir"][:-1]])[:, None],  # held since the row before
        metadata={
            "kp": FORCE * gains.kv * gains.kp,
            "kd": FORCE * gains.kv,
            "source": "EMPS, Janot, Gautier, Brunot 2019",
            "note": "the drive takes the mean speed of its last two periods: its velocity is 1 ms late",
        },
    )


def go2_log(path: Path) -> JointLog:
    """Return the Go2 file with its joints named as in the model; gains of the configuration in its repository."""
    table = pq.read_table(path)
    names = [n.removeprefix("q_") for n in table.column_names if n.startswith("q_")]
    return JointLog(
        joints=tuple(f"{n}_joint" for n in names),
        t=table["t"].to_numpy(),
        q=np.stack([table[f"q_{n}"].to_numpy() for n in names], -1),
        q_des=np.stack([table[f"qdes_{n}"].to_numpy() for n in names], -1),
        metadata={"kp": 20.0, "kd": 1.5, "source": "iit-DLSLab/sim2real-robot-identification, datasets/go2"},
    )


def servo_logs(folder: Path, kp: float = SERVO_GAINS["kp"], kd: float = SERVO_GAINS["kd"]) -> dict[str, JointLog]:
    """Return the STS3250 logs by motion; the gains of the servo are declared [N m/rad, N m s/rad]."""
    made = {}
    for path in sorted(folder.glob("*.json")):
        raw = json.loads(path.read_text(encoding="utf-8"))
        columns = {k: np.array([float(e[k]) for e in raw["entries"]]) for k in raw["entries"][0]}
        made[raw["trajectory"]] = JointLog(
            joints=("j",),
            t=columns["timestamp"],
            q=columns["position"][:, None],
            q_des=columns["goal_position"][:, None],
            extra={"enabled": columns["torque_enable"]},
            metadata={"kp": kp, "kd": kd, "source": "Rhoban/bam, data_raw_feetech"},
        )
    return made


def xl330_logs(folder: Path) -> dict[str, JointLog]:
    """Return the XL330 logs by name, as logs of a voltage drive with the supply of each row."""
    made = {}
    for path in sorted(folder.glob("*.parquet")):
        table = pq.read_table(path)
        notes = {k.decode(): v.decode() for k, v in table.schema.metadata.items() if k != b"pandas"}
        columns = {n: table[n].to_numpy().astype(np.float64) for n in table.column_names}
        gain = float(notes["kp"]) * DUTY
        made[path.stem] = JointLog(
            joints=("j",),
            t=columns["timestamp"],
            q=columns["position"][:, None],
            q_des=columns["goal_position"][:, None],
            extra={"enabled": columns["torque_enable"], "voltage": columns["input_volts"]},
            metadata={"drive": "voltage", "gain": gain, "voltage": float(notes["vin"]), **XL330_MOTOR},
        )
    return made


def divided(log: JointLog, share: float = 0.5) -> tuple[JointLog, JointLog]:
    """Return this share of a log, and the rest, as two logs."""
    at = int(share * len(log.t))
    return log.part(slice(at)), log.part(slice(at, None))


def _relative(made: FloatArray, measured: FloatArray) -> float:
    return float(100 * np.linalg.norm(made - measured) / np.linalg.norm(measured))


def main() -> None:
    """Write the logs and models, and print the figures."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("data", type=Path, help="folder with emps/, go2_air_chirp/, sts3250/ and xl330/")
    parser.add_argument("out", type=Path)
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    for name in CLOSED_LOOP:
        columns = read_emps(arguments.data / "emps" / f"{name}.parquet")
        gains = identify(columns)
        print(f"{name}: kp {gains.kp:.3f} 1/s, kv {gains.kv:.3f} V s/m, {100 * gains.left:.3f} % of the voltage left")
        if gains.added:
            print(f"  {gains.added:.4f} V for each volt of the pulses")
        speed = np.gradient(columns["qm"], TICK)
        for title, model in (("symmetric", PUBLISHED), ("asymmetric", ASYMMETRIC)):
            q, v, force = replay(columns, model, gains)
            rms = 1e6 * np.sqrt(np.mean((q - columns["qm"]) ** 2))
            figures = (
                f"position {_relative(q, columns['qm']):.5f} % ({rms:.2f} um), velocity {_relative(v, speed):.4f} %"
            )
            print(f"  {title}: {figures}, force {_relative(force, FORCE * columns['vir']):.3f} %")
        print("  published, symmetric: position {} %, velocity {} %".format(*CLOSED_LOOP[name]))
        write_log(emps_log(columns, gains), arguments.out / f"{name.removeprefix('DATA_').lower()}.parquet")
    (arguments.out / "emps.xml").write_text(EMPS_MJCF, encoding="utf-8")
    go2 = go2_log(arguments.data / "go2_air_chirp" / "log.parquet")
    write_log(go2, arguments.out / "go2.parquet")
    for name, half in zip(("first", "second"), divided(go2), strict=True):
        write_log(half, arguments.out / f"go2_{name}.parquet")
    for motion, log in servo_logs(arguments.data / "sts3250").items():
        write_log(log, arguments.out / f"servo_{motion}.parquet")
    (arguments.out / "servo.xml").write_text(SERVO_MJCF, encoding="utf-8")
    for name, log in xl330_logs(arguments.data / "xl330").items():
        write_log(log, arguments.out / f"xl330_{name}.parquet")
    (arguments.out / "xl330.xml").write_text(XL330_MJCF, encoding="utf-8")
    shutil.copyfile(arguments.data / "go2_air_chirp" / "go2_hung.xml", arguments.out / "go2.xml")
    print(f"wrote {arguments.out}")


if __name__ == "__main__":
    main()
