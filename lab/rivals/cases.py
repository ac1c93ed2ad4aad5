"""Logs of one machine to fit, and another log of it, of another motion, that no method sees before it is judged."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from lab.hidden_effects.generator import measured, simulate
from lab.hidden_effects.scenarios import Scenario, build
from lab.hidden_effects.suite import hung, legs_mjcf
from lab.real_logs.logs import (
    EMPS_MJCF,
    SERVO_MJCF,
    XL330_MJCF,
    divided,
    emps_log,
    go2_log,
    identify,
    read_emps,
    servo_logs,
    xl330_logs,
)
from mimic.dynamics.excitation import hung_ranges, probe_targets
from mimic.dynamics.machine import MachineModel, read_machine
from mimic.io.joint_log import JointLog, read_log
from mimic.robot.description import load_description

Ranges = Mapping[tuple[str, str], tuple[float, float]]

LEG_RANGES: Ranges = {
    ("coulomb", "level"): (0.0, 0.3),
    ("viscous", "coefficient"): (0.0, 0.1),
    ("link_mass", "factor"): (0.8, 1.2),
    ("armature", "inertia"): (0.001, 0.02),
    ("encoder_offset", "angle"): (-0.1, 0.1),
    ("delay", "time"): (0.0, 0.03),
}
"""Source: Li et al. 2024, section IV, for friction, damping, mass and delay."""

ARM_EFFECTS: Mapping[str, tuple[str, ...]] = {
    "asym": ("asymmetric_friction",),
    "backlash": ("backlash",),
    "belt": ("compliance",),
    "boucwen": (),
    "ecc": ("encoder_eccentricity",),
    "heat": ("kt_heat",),
    "tgtfilter": ("target_filter",),
    "tlimit": ("torque_speed",),
}
"""What is hidden in each log of the arm, in the words of the catalogue; () where it has no word for it."""

SERVO_DRIVE = {"kp": 53.7, "kd": 1.19, "torque": 5.05, "speed": 8.88, "armature": 0.00725}
"""Drive of the STS3250 [N m/rad, N m s/rad, N m, rad/s, kg m^2], which every method is given; its register does not
say it. Source: the baseline of ``mimic calibrate``, with gains, rotor and torque-speed line, on the fitted logs."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Case:
    """One machine."""

    title: str
    hidden: tuple[str, ...] | None
    """What is hidden, or documented; None where nobody knows."""
    fitted: tuple[JointLog, ...]
    test: JointLog
    machine: MachineModel
    mjcf: str
    """The same model as text."""
    ranges: Ranges
    """Where the methods that need ranges look."""
    unit: tuple[str, float] = ("mrad", 1e3)
    judged_from: float = 0.0
    """From when on the test log is judged [s]: where it begins in motion, its speed is not known at first."""


def leg_case(key: str) -> Case:
    """Return one leg of a machine of the suite, and the same leg in another motion."""
    scenario = Scenario.of(key)
    built = build(scenario)
    again = probe_targets(
        *hung_ranges(load_description("cyberdog2")), seconds=10.0, seed=built.seed % 1000 + 7, kind="random"
    )
    fitted = measured(simulate(built.machine, built.motion, built.seed), built.seed).of(built.leg)
    test = measured(simulate(built.machine, again, built.seed + 1), built.seed + 1).of(built.leg)
    title = f"leg, {' + '.join(scenario.names).replace('_', ' ') or 'nothing'} hidden"
    return Case(
        title=title,
        hidden=scenario.names,
        fitted=(fitted,),
        test=test,
        machine=hung(built.leg),
        mjcf=legs_mjcf(built.leg),
        ranges=LEG_RANGES,
    )


def emps_case(folder: Path) -> Case:
    """Return the EMPS file to fit and the one with pulses to judge by."""
    logs = []
    for name in ("DATA_EMPS", "DATA_EMPS_PULSES"):
        columns = read_emps(folder / "emps" / f"{name}.parquet")
        logs.append(emps_log(columns, identify(columns)))
    return Case(
        title="EMPS, judged by PULSES",
        hidden=("asymmetric_friction",),
        fitted=(logs[0],),
        test=logs[1],
        machine=_compiled(EMPS_MJCF),
        mjcf=EMPS_MJCF,
        ranges={
            ("coulomb", "level"): (0.0, 60.0),
            ("viscous", "coefficient"): (0.0, 500.0),
            ("link_mass", "factor"): (0.8, 1.2),
            ("armature", "inertia"): (0.0, 20.0),
            ("encoder_offset", "angle"): (-1e-3, 1e-3),
            ("delay", "time"): (-0.002, 0.004),  # below 0: the rows show a target later than the drive has it
        },
        unit=("µm", 1e6),
    )


def servo_case(folder: Path) -> Case:
    """Return three logs of the STS3250 to fit and the one that moves up and down to judge by."""
    drive = SERVO_DRIVE
    logs = tuple(servo_logs(folder / "sts3250", drive["kp"], drive["kd"]).values())
    text = SERVO_MJCF.replace("-9 9", f"-{drive['torque']} {drive['torque']}")
    text = text.replace('armature="0.005"', f'armature="{drive["armature"]}"')
    machine = _compiled(text)
    speed = np.full_like(machine.drives.torque, drive["speed"])
    machine = replace(machine, drives=replace(machine.drives, speed=speed, flat=np.zeros_like(speed)))
    return Case(
        title="STS3250, three logs, judged by the fourth",
        hidden=("load_friction",),
        fitted=logs[:3],
        test=logs[3],
        machine=machine,
        mjcf=text,
        ranges={
            ("coulomb", "level"): (0.0, 1.0),
            ("viscous", "coefficient"): (0.0, 1.0),
            ("link_mass", "factor"): (0.3, 3.0),
            ("armature", "inertia"): (0.0, 0.1),
            ("encoder_offset", "angle"): (-0.1, 0.1),
            ("delay", "time"): (-0.01, 0.06),
        },
    )


def xl330_case(folder: Path, left_out: str) -> Case:
    """Return seven logs of the XL330, a voltage drive, to fit and the eighth to judge by."""
    logs = xl330_logs(folder / "xl330")
    test = logs.pop(left_out)
    return Case(
        title=f"XL330, seven logs, judged by {left_out.replace('_', ' ')}",
        hidden=("load_friction",),
        fitted=tuple(logs.values()),
        test=test,
        machine=_compiled(XL330_MJCF),
        mjcf=XL330_MJCF,
        ranges={
            ("coulomb", "level"): (0.0, 0.2),
            ("viscous", "coefficient"): (0.0, 0.1),
            ("link_mass", "factor"): (0.8, 1.2),
            ("armature", "inertia"): (0.0, 0.02),
            ("encoder_offset", "angle"): (-0.1, 0.1),
            ("delay", "time"): (-0.01, 0.03),
        },
    )


def arm_case(folder: Path, name: str) -> Case:
    """Return two thirds of a log of the arm of another pen to fit and the last third to judge by."""
    hidden = ARM_EFFECTS[name.split("_")[-2]]
    what = " ".join(hidden or ("something unknown",)).replace("_", " ")
    ranges = {**LEG_RANGES, ("coulomb", "level"): (0.0, 0.6), ("viscous", "coefficient"): (0.0, 0.3)}
    log = read_log(folder / "arm" / f"{name}.parquet")
    title = f"arm, {what} hidden, judged by its last third"
    return _by_its_rest(title, hidden, log, 2 / 3, folder / "arm" / "arm.xml", ranges)


def go2_case(folder: Path) -> Case:
    """Return the first half of the Go2's log in the air to fit and the second to judge by."""
    ranges = {**LEG_RANGES, ("coulomb", "level"): (0.0, 1.0), ("viscous", "coefficient"): (0.0, 0.5)}
    air = folder / "go2_air_chirp"
    log = go2_log(air / "log.parquet")
    return _by_its_rest("Go2 in the air, judged by the second half", None, log, 1 / 2, air / "go2_hung.xml", ranges)


def _by_its_rest(
    title: str, hidden: tuple[str, ...] | None, log: JointLog, share: float, model: Path, ranges: Ranges
) -> Case:
    """Return a share of a log to fit and the rest, which begins in motion, to judge by."""
    fitted, test = divided(log, share)
    text = model.read_text(encoding="utf-8")
    return Case(
        title=title,
        hidden=hidden,
        fitted=(fitted,),
        test=test,
        machine=_compiled(text),
        mjcf=text,
        ranges=ranges,
        judged_from=1.0,
    )


def _compiled(mjcf: str) -> MachineModel:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "model.xml"
        path.write_text(mjcf, encoding="utf-8")
        return read_machine(path)


def switched_on(log: JointLog) -> bool:
    """Return whether the drives are on in all of a log."""
    return "enabled" not in log.extra or bool(np.all(log.extra["enabled"]))
