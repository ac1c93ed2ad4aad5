"""An IMU that sets its heading anew while the robot stands."""

from __future__ import annotations

from dataclasses import replace

from mimic.config.play import RunSettings
from mimic.flows.motions.motion import motion_from_text
from mimic.flows.play import play
from mimic.geometry import heading_from_quat, turned_about_up, wrap_angle
from mimic.simulation.plant import SimulatedPlant


class ResetHeading:
    """A simulated robot whose IMU adds an angle to its heading from a time on."""

    def __init__(self, plant: SimulatedPlant, angle: float, at: float) -> None:
        self._plant, self._angle, self._at = plant, angle, at
        self.description = plant.description
        self.true_heading = 0.0

    def start(self):
        return self._plant.start()

    def step(self, command):
        tick = self._plant.step(command)
        self.true_heading = float(heading_from_quat(tick.state.quat_WB))
        if tick.state.t < self._at:
            return tick
        return replace(tick, state=replace(tick.state, quat_WB=turned_about_up(tick.state.quat_WB, self._angle)))

    def damp(self):
        return self._plant.damp()

    def close(self):
        self._plant.close()


def test_it_stands_on_where_it_looked_before(description):
    plant = ResetHeading(SimulatedPlant(description, seed=1), -2.5, at=4.0)
    begin = float(heading_from_quat(plant.start().quat_WB))
    done = play(motion_from_text("wave the left hand twice"), plant=plant, settings=RunSettings(seed=1))
    assert [event.rule for event in done.events] == ["imu_contradiction", "finished"]
    assert done.shortfall is None
    assert abs(wrap_angle(plant.true_heading - begin)) < 0.5
