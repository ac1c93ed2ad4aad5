"""Calibrate any MJCF from a log: a pendulum whose joint has dry friction that its model lacks.

    python examples/calibrate_any_machine.py [FOLDER]

The log comes from a simulated pendulum, so the truth is known. With a log of a real machine, replace `simulate_log` by
the path of your Parquet or CSV file.
"""

import sys
import tempfile
from pathlib import Path

import mimic
from mimic.config.sysid import CalibrateSettings, LogMotion, LogSettings

PENDULUM = """
<mujoco model="pendulum">
  <worldbody>
    <body name="rod">
      <joint name="pivot" type="hinge" axis="0 1 0" range="-90 90" armature="0.01"/>
      <geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.02" mass="0.5"/>
    </body>
  </worldbody>
  <actuator>
    <position name="pivot" joint="pivot" kp="20" kv="0.5" forcerange="-10 10"/>
  </actuator>
</mujoco>
"""
HIDDEN = """
[[effect]]
name = "coulomb"
joints = ["pivot"]
level = 0.4
"""


def main(folder: str | Path | None = None) -> None:
    out = Path(folder or tempfile.mkdtemp(prefix="calibration-"))
    out.mkdir(parents=True, exist_ok=True)
    model, hidden = out / "pendulum.xml", out / "hidden.toml"
    model.write_text(PENDULUM, encoding="utf-8")
    hidden.write_text(HIDDEN, encoding="utf-8")

    log = mimic.simulate_log(hidden, model, LogMotion(seconds=10.0), LogSettings(timestep=0.001))
    # Fitting friction alone takes seconds; the defaults also search the whole catalogue of effects, for minutes.
    settings = CalibrateSettings(baseline=("coulomb", "viscous"), most_effects=0)
    result = mimic.calibrate(log, model, settings, out=out)

    print(result.sentence)
    for effect in result.effects:
        print(effect.name, {name: value.round(3).tolist() for name, value in effect.values.items()})
    print(f"report: {out / 'report.html'}")


if __name__ == "__main__":
    main(*sys.argv[1:])
