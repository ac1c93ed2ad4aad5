"""The emulated robot: motors, IMU and body on one or more buses, in a time of its own.

Whoever has it says how far time goes: a server lets it follow the clock on the wall (:mod:`mimic.run.emulator_server`), a
link in the same process lets it run as fast as it can be computed (:mod:`mimic.run.emulated_link`) and repeatably.
"""

from __future__ import annotations

import heapq
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from mimic.errors import BusError, ConfigError
from mimic.robot.description import RobotDescription
from mimic.robot.effect_set import EffectSet
from mimic.robot.wiring import Wiring
from mimic.run.can_frame import EXTENDED_IDS, STANDARD_IDS, CanFrame
from mimic.run.cybergear import Codec
from mimic.run.emulated_body import EmulatedBody
from mimic.run.emulated_bus import EmulatedBus, Sent
from mimic.run.emulated_faults import EmulatedFault
from mimic.run.emulated_imu import EmulatedMti
from mimic.run.emulated_motor import FREE, ROTOR_TURN, Drive, EmulatedMotor, Measured
from mimic.run.link import Received
from mimic.run.motor_messages import Fault, Mode, MotorMessage
from mimic.settings import EmulateSettings
from mimic.types import JOINTS

VOLTAGE = 24.0
"""Of the supply [V]; manual, rated."""

LOOK_EVERY = 0.01
"""How often motors look at temperature, voltage and the time since they heard a host [s]."""

HUNG_TIMESTEP = 0.0005
"""Longest step of the physics of a robot that hangs [s]: it is there to be measured, and motors read between the steps."""

POWER_UP = 0.05
"""Motors have told their ids within this after the power came [s]."""

IMU = "imu"


@dataclass(eq=False)
class Host:
    """A computer on the emulated buses."""

    node: str
    """Name on the buses."""
    bus: int | None = None
    """The only one it is on; None for all."""
    heard: deque[Received] = field(default_factory=deque)
    """Frames that it has not taken yet; its own are not among them."""


class EmulatedRobot:
    """Twelve motors and an IMU on their buses, and the body that they move."""

    def __init__(
        self,
        description: RobotDescription,
        wiring: Wiring,
        settings: EmulateSettings | None = None,
        *,
        effects: EffectSet | None = None,
        faults: Sequence[EmulatedFault] = (),
        timestep: float = 0.0025,
        visuals: bool = False,
    ) -> None:
        """Switch the robot on.

        Args:
            description: The robot.
            wiring: Where its motors are.
            settings: How it is; by default lying, its zeros lost.
            effects: What its drives, links and encoders have besides.
            faults: What goes wrong and when; more by :meth:`inject`.
            timestep: Of the physics [s]; no more than HUNG_TIMESTEP for a robot that hangs.
            visuals: Keep the shapes that are only looked at.

        Raises:
            ConfigError: If the effects are not of this robot, or a fault is on a bus that is not there.
        """
        self.settings = s = EmulateSettings() if settings is None else settings
        self.wiring = wiring
        self.body = EmulatedBody(
            description,
            effects=effects,
            hung=s.hung,
            timestep=min(timestep, HUNG_TIMESTEP) if s.hung else timestep,
            placement=s.placement,
            seed=s.seed,
            visuals=visuals,
        )
        self.buses = [EmulatedBus(wiring.bitrate) for _ in range(wiring.buses)]
        self.imu = EmulatedMti(wiring.imu, noise=s.imu_noise, seed=s.seed)
        self.now = 0.0
        """Time of the emulation [s]."""
        self._rng = np.random.default_rng([s.seed, 29])
        self._faults: list[EmulatedFault] = []
        self._happened: set[int] = set()
        self._codec = Codec(position_range=s.position_range)
        self.motors = [
            EmulatedMotor(
                id=int(wiring.motor[i]),
                uid=int(self._rng.integers(1 << 62)),
                codec=self._codec,
                encoder=float(self._rng.uniform(0.0, ROTOR_TURN)),
                timeout_honoured=s.can_timeout,
                host=wiring.host,
            )
            for i in range(len(JOINTS))
        ]
        """In the order of the joints."""
        self._on_bus = [[i for i in range(len(JOINTS)) if wiring.bus[i] == bus] for bus in range(wiring.buses)]
        self._driven = [FREE] * len(JOINTS)
        self.told: deque[tuple[float, str]] = deque(maxlen=1000)
        """What happened to it and when [s]: faults, the first motor switched on."""
        self._late: list[tuple[float, int, int, Sent]] = []
        self._late_count = 0
        self._next_look = LOOK_EVERY
        self._hosts: list[Host] = []
        self._host_count = 0
        for i, motor in enumerate(self.motors):
            told = motor.power_up(self._measured(i).q)
            if s.homed:
                motor.zero = 0.0
            self._tell(i, told, self._rng.uniform(0.0, POWER_UP))
        for fault in faults:
            self.inject(fault)

    # ------------------------------------------------------------------ from outside

    def inject(self, fault: EmulatedFault) -> None:
        """Put a fault on the schedule; one that should have begun begins now.

        Raises:
            ConfigError: If it is on a bus that is not there.
        """
        if fault.bus is not None and fault.bus >= len(self.buses):
            raise ConfigError(f"the fault {fault} is on bus {fault.bus}; this robot has {len(self.buses)}")
        self._faults.append(fault if self.body.held else fault.released(self.now))

    def connect(self, *, bus: int | None = None) -> Host:
        """Return another host, on one bus or on all."""
        self._host_count += 1
        host = Host(f"host{self._host_count}", bus)
        self._hosts.append(host)
        return host

    def disconnect(self, host: Host) -> None:
        """Take a host from the buses; what it has sent still goes out."""
        if host in self._hosts:
            self._hosts.remove(host)

    def send(self, host: Host, bus: int, frame: CanFrame, *, at: float | None = None) -> None:
        """Let a host send a frame on a bus, now or from a later time on.

        Raises:
            BusError: If the bus is unplugged.
        """
        if self.unplugged(bus):
            raise BusError(f"bus {bus} is unplugged")
        at = self.now if at is None else max(at, self.now)
        self.buses[bus].submit(host.node, frame, max(at, self._held_until(bus)))

    def unplugged(self, bus: int) -> bool:
        """Return whether the adapter of a bus is gone."""
        return self._value("unplugged", bus=bus) is not None

    @property
    def next_event(self) -> float:
        """When something happens next if no host sends anything [s]."""
        times = [bus.next_event for bus in self.buses]
        times += [self.imu.next_sample, self._next_look]
        if self._late:
            times.append(self._late[0][0])
        times += [f.start for i, f in enumerate(self._faults) if i not in self._happened and not f.after_release]
        return min(times)

    def advance(self, until: float, *, waiting: Host | None = None) -> None:
        """Let time go on to ``until`` [s], or only until a waiting host hears something."""
        while (event := self.next_event) <= until:
            self.now = max(self.now, event)
            self._happen()
            if waiting is not None and waiting.heard:
                return
        self.now = max(self.now, until)
        self.body.advance(self.now)

    def load(self, bus: int = 0) -> float:
        """Return which share of its time a bus was busy since the beginning."""
        return self.buses[bus].bits / self.buses[bus].bitrate / self.now if self.now else 0.0

    # ------------------------------------------------------------------ events

    def _happen(self) -> None:
        """Do all that is due now."""
        for i, fault in enumerate(self._faults):
            if i not in self._happened and fault.start <= self.now and not fault.after_release:
                self._happened.add(i)
                self.told.append((self.now, str(fault)))
                self._begin(fault)
        for index, bus in enumerate(self.buses):
            bus.off = self._value("bus_off", bus=index) is not None or self.unplugged(index)
            if bus.off or bus.next_event <= self.now:
                sent = bus.advance()
                if sent is not None:
                    self._pass_on(index, sent)
        while self._late and self._late[0][0] <= self.now:
            _, _, index, sent = heapq.heappop(self._late)
            self._deliver(index, sent._replace(t=self.now))
        if self.imu.next_sample <= self.now:
            self._sample_imu()
        if self._next_look <= self.now:
            self._next_look += LOOK_EVERY
            self._look_after_motors()

    def _begin(self, fault: EmulatedFault) -> None:
        """Do what happens once when a fault begins."""
        if fault.kind == "power_cycle" and fault.joint is not None:
            i = fault.joint
            told = self.motors[i].power_up(self._measured(i).q)
            self._apply(i)
            self._tell(i, told, self.now + self._rng.uniform(0.0, POWER_UP))
        elif fault.kind == "motor_dead" and fault.joint is not None:
            self.motors[fault.joint].power_up(self._measured(fault.joint).q)
            self._apply(fault.joint)

    def _pass_on(self, index: int, sent: Sent) -> None:
        """Let a frame that was on the bus come to its listeners: once, twice, late, wrong or never."""
        lost, twice = self._value("frames_lost", bus=index), self._value("frames_doubled", bus=index)
        wrong, late = self._value("frames_corrupted", bus=index), self._value("frames_late", bus=index)
        if lost is not None and self._rng.random() < lost:
            return
        if wrong is not None and self._rng.random() < wrong:
            sent = sent._replace(frame=self._corrupted(sent.frame))
        count = 2 if twice is not None and self._rng.random() < twice else 1
        held = self._held_until(index) if not sent.node.startswith("host") else 0.0
        due = max(sent.t + (late or 0.0), held)
        for _ in range(count):
            if due > sent.t:
                self._late_count += 1
                heapq.heappush(self._late, (due, self._late_count, index, sent))
            else:
                self._deliver(index, sent)

    def _corrupted(self, frame: CanFrame) -> CanFrame:
        bits = (29 if frame.extended else 11) + 8 * len(frame.data)
        place = int(self._rng.integers(bits))
        if place < 8 * len(frame.data):
            data = bytearray(frame.data)
            data[place // 8] ^= 1 << place % 8
            return CanFrame(frame.id, bytes(data), frame.extended)
        identifier = frame.id ^ 1 << (place - 8 * len(frame.data))
        return CanFrame(identifier % (EXTENDED_IDS if frame.extended else STANDARD_IDS), frame.data, frame.extended)

    def _deliver(self, index: int, sent: Sent) -> None:
        if sent.node.startswith("host"):
            for i in self._on_bus[index]:
                if self._value("motor_dead", joint=i) is None and self._value("motor_deaf", joint=i) is None:
                    self._hear(i, sent)
        for host in self._hosts:
            if host.node != sent.node and host.bus in (None, index):
                host.heard.append(Received(index, sent.frame, sent.t))

    def _hear(self, i: int, sent: Sent) -> None:
        motor = self.motors[i]
        if not sent.frame.extended or sent.frame.id & 0xFF != motor.id:
            return
        answer = motor.hear(sent.frame, sent.t, self._measured(i))
        self._apply(i)
        if motor.mode is Mode.RUN and self.body.held:
            self.body.release()
            self.told.append((self.now, "first motor switched on; nobody holds the robot any more"))
            self._faults = [fault.released(self.now) for fault in self._faults]
        if answer is not None:
            self._tell(i, answer, sent.t + self.settings.reply)

    def _tell(self, i: int, message: MotorMessage, ready: float) -> None:
        if self._value("motor_mute", joint=i) is None and self._value("motor_dead", joint=i) is None:
            self.buses[int(self.wiring.bus[i])].submit(f"motor{i}", self._codec.encode(message), ready)

    def _apply(self, i: int) -> None:
        """Hand over to the body what a motor does, in the joint's sign and zero."""
        drive = self.motors[i].drive
        if drive is self._driven[i]:
            return
        self._driven[i] = drive
        sign, offset = float(self.wiring.sign[i]), float(self.wiring.offset[i])
        joint = Drive(
            drive.kp, drive.kd, sign * drive.q + offset, sign * drive.dq, sign * drive.tau, drive.limit, drive.pace
        )
        self.body.drive(i, joint, self.now)

    def _measured(self, i: int) -> Measured:
        self.body.advance(self.now)
        q, dq, tau = self.body.joint(i, self.now)
        sign, offset = float(self.wiring.sign[i]), float(self.wiring.offset[i])
        return Measured(sign * (q - offset), sign * dq, sign * tau, *self._heat_and_voltage(i))

    def _heat_and_voltage(self, i: int) -> tuple[float, float]:
        heat = self.body.temperature(i)
        hot, voltage = self._value("motor_hot", joint=i), self._value("under_voltage")
        return heat if hot is None else max(heat, hot), VOLTAGE if voltage is None else voltage

    def _look_after_motors(self) -> None:
        self.body.advance(self.now)
        for i, motor in enumerate(self.motors):
            if self._value("motor_dead", joint=i) is not None:
                continue
            bits = self._value("motor_fault", joint=i)
            more = Fault(0) if bits is None else Fault(int(bits) & 0x3F)
            report = motor.look_after(self.now, *self._heat_and_voltage(i), more)
            self._apply(i)
            if report is not None:
                self._tell(i, report, self.now)

    def _sample_imu(self) -> None:
        self.body.advance(self.now)
        frames = self.imu.sample(
            *self.body.base(),
            valid=self._value("imu_invalid") is None,
            frozen=self._value("imu_frozen") is not None,
            stuck=self._value("imu_stuck") is not None,
            tilt=self._value("imu_tilted") or 0.0,
        )
        if self._value("imu_silent") is None:
            for frame in frames:
                self.buses[self.wiring.imu.bus].submit(IMU, frame, self.now)

    def _value(self, kind: str, *, joint: int | None = None, bus: int | None = None) -> float | None:
        """Return the value of a fault that is there now, or None."""
        if not self._faults:
            return None
        for fault in self._faults:
            if fault.kind == kind and fault.joint == joint and fault.bus in (None, bus) and fault.active(self.now):
                return fault.value
        return None

    def _held_until(self, bus: int) -> float:
        """Return until when the adapter of a bus keeps everything back [s]."""
        ends = [f.until for f in self._faults if f.kind == "stalled" and f.bus in (None, bus) and f.active(self.now)]
        return max(ends, default=0.0)
