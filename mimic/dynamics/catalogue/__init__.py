"""The catalogue of physical effects: equations, parameters, units, bounds and signatures.

One catalogue for simulation, training, calibration and the emulator. `mimic.dynamics.law` turns the parameters
into what the physics is given at every step; this module only says what exists. A parameter at its neutral value has no
effect at all. Signs and letters: tau torque at the joint, q and v its position and velocity, e the target less the
measured position, residual = measured - predicted.

Joints may slide instead of turn: read N for N m, m for rad.

Longer than 350 lines: a table of data, one entry for each effect.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from mimic.errors import ConfigError

MODEL = "model"
"""Neutral value of a parameter that replaces a number of the model."""


class UnknownEffect(ConfigError):
    """An effect that the catalogue does not have."""

    def __init__(self, name: str) -> None:
        self.name = name
        super().__init__(f"effect {name!r} is not in the catalogue; it has {', '.join(CATALOGUE)}")


GAPS = tuple(2.5 * 1.2**k for k in range(19))
"""Starts of a backlash, in differences that matter: a fit finds one only from within a sixth of it."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Parameter:
    """One number of an effect, for each joint or for the whole machine."""

    name: str
    unit: str
    neutral: float | Literal["model"]
    """Value without the effect; "model" where the model has a number of its own."""
    low: float
    high: float
    step: float
    """A difference that matters, and the unit of ``starts`` and ``spread``: a share of the machine's own scale for
    units that have one (`scale_of`), else a value.
    """
    starts: tuple[float, ...] = ()
    """Values from which a fit begins, in steps; empty where it begins at neutral. Of the torque-speed line: shares of
    the largest torque and speed of the log. Of a fixed parameter: its value."""
    spread: float = 100.0
    """How far from neutral is plausible (one standard deviation), in steps."""
    shape: bool = False
    """Says where or when the effect acts, not how much: at any value it is none while the others are neutral."""
    fixed: bool = False
    """Never fitted: it has its value from ``starts`` or from a person."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Effect:
    """One physical effect."""

    name: str
    title: str
    """How a sentence names it."""
    equation: str
    parameters: tuple[Parameter, ...]
    scope: Literal["joint", "machine"] = "joint"
    """Whether each joint has parameters of its own, or the machine has one set."""
    baseline: bool = False
    """Part of every model; fitted first."""
    structural: bool = False
    """A threshold or an added state: a derivative at neutral does not see it, so it is always refitted."""
    tip: bool = False
    """Only the last joint of a chain can have it."""
    chain_shared: bool = False
    """All joints of a chain have it or none.

    A factor common to these numbers, masses and friction hardly changes the motion, so that any one of them may seem to
    be none, and would fix that factor were it left out.
    """
    random: bool = False
    """Drawn anew for each target, so a replay needs what was drawn: it is read off the log, not fitted."""
    signature: str
    """What its residual looks like."""
    experiment: str
    """The motion that shows it best."""
    enters: str
    """How it enters MuJoCo."""
    source: str

    @property
    def read_off(self) -> bool:
        """Whether its size is read off the log, not fitted."""
        return self.random or all(p.fixed or p.shape for p in self.parameters)

    def parameter(self, name: str) -> Parameter:
        """Return a parameter by name.

        Raises:
            ConfigError: If there is none.
        """
        for p in self.parameters:
            if p.name == name:
                return p
        names = ", ".join(p.name for p in self.parameters)
        raise ConfigError(f"effect {self.name!r} has no parameter {name!r}; it has {names}")


_CAL = "standard model; MuJoCo 4 documentation, Computation"

_ALL = (
    # ---------------------------------------------------------------- baseline: what every model has
    Effect(
        name="coulomb",
        title="dry friction",
        equation="tau = -level sgn(v), up to level while at rest",
        parameters=(Parameter(name="level", unit="N m", neutral=MODEL, low=0.0, high=50.0, step=0.01),),
        baseline=True,
        signature="lag at every reversal",
        experiment="slow ramps against fast sines",
        enters="dof_frictionloss",
        source="Coulomb 1785; MuJoCo documentation, frictionloss",
    ),
    Effect(
        name="viscous",
        title="viscous friction",
        equation="tau = -coefficient v",
        parameters=(Parameter(name="coefficient", unit="N m s/rad", neutral=MODEL, low=0.0, high=500.0, step=0.01),),
        baseline=True,
        signature="lag in proportion to speed",
        experiment="fast sines; a second log with another Kd tells it from Kd",
        enters="dof_damping",
        source="MuJoCo documentation, damping",
    ),
    Effect(
        name="link_mass",
        title="mass of the moved link",
        equation="mass and inertia of the link times factor",
        parameters=(Parameter(name="factor", unit="1", neutral=1.0, low=0.3, high=3.0, step=0.03, spread=5),),
        baseline=True,
        signature="error that follows gravity over the pose, and acceleration",
        experiment="static poses and a chirp",
        enters="body_mass, body_inertia",
        source="Li et al. 2024, Table II",
    ),
    Effect(
        name="delay",
        title="command delay",
        equation="the target acts time later",
        parameters=(Parameter(name="time", unit="s", neutral=0.0, low=-0.01, high=0.1, step=0.001, spread=30),),
        scope="machine",
        baseline=True,
        signature="residual in proportion to the speed of the target",
        experiment="steps and a chirp",
        enters="command path; actuator delay in MJCF",
        source="Li et al. 2024, section IV",
    ),
    # ---------------------------------------------------------------- the drive
    Effect(
        name="armature",
        title="reflected rotor inertia",
        equation="tau = -inertia dv/dt, beside the links",
        parameters=(Parameter(name="inertia", unit="kg m^2", neutral=MODEL, low=0.0, high=200.0, step=0.01),),
        signature="grows with the square of the frequency, in phase with acceleration",
        experiment="chirp to 8-10 Hz",
        enters="dof_armature",
        source="MuJoCo documentation, armature",
    ),
    Effect(
        name="gains",
        title="gains of the drive",
        equation="Kp and Kd times kp and kd",
        parameters=(
            Parameter(name="kp", unit="1", neutral=1.0, low=0.2, high=5.0, step=0.02, spread=20),
            Parameter(name="kd", unit="1", neutral=1.0, low=0.2, high=5.0, step=0.02, spread=20),
        ),
        chain_shared=True,
        signature="as friction and mass together; without measured torque kd stays 1: viscous friction acts alike",
        experiment="two logs with gains that differ by a known factor",
        enters="actuator_gainprm, actuator_biasprm",
        source="Li et al. 2024, Table II",
    ),
    Effect(
        name="torque_speed",
        title="torque limit and torque-speed line",
        equation="|tau| <= torque, and <= torque (speed - |v|) / (speed - flat) while driving",
        parameters=(
            Parameter(name="torque", unit="N m", neutral=MODEL, low=0.1, high=500.0, step=0.02, starts=(0.2, 0.4, 0.8)),
            Parameter(
                name="speed", unit="rad/s", neutral=MODEL, low=0.5, high=200.0, step=0.02, starts=(0.3, 0.7, 1.5)
            ),
            Parameter(
                name="flat",
                unit="rad/s",
                neutral=MODEL,
                low=0.0,
                high=100.0,
                step=1.0,
                starts=(0.0,),
                fixed=True,
                shape=True,
            ),
        ),
        structural=True,
        signature="only where torque and speed are both high",
        experiment="large steps and fast sines",
        enters="actuator_forcerange at every step; dcmotor saturation in MJCF",
        source="CyberGear manual, torque-speed chart",
    ),
    Effect(
        name="supply_sag",
        title="sagging supply",
        equation="torque limit and speeds times 1 - drop P, P = sum over joints of max(tau v, 0)",
        parameters=(
            Parameter(name="drop", unit="1/W", neutral=0.0, low=0.0, high=0.1, step=0.001, starts=(2, 6), spread=30),
        ),
        scope="machine",
        structural=True,
        signature="as a torque limit, at the same times in all joints",
        experiment="all joints fast at once",
        enters="actuator_forcerange at every step",
        source="resistance of supply and wiring, V = V0 - R I",
    ),
    Effect(
        name="kt_gain",
        title="torque constant",
        equation="tau = factor tau_cmd",
        parameters=(Parameter(name="factor", unit="1", neutral=1.0, low=0.3, high=3.0, step=0.02, spread=15),),
        chain_shared=True,
        signature="in proportion to torque; the same motion as other masses and friction",
        experiment="a known mass, or measured torque",
        enters="actuator_gainprm, actuator_biasprm",
        source="DC motor, tau = Kt i",
    ),
    Effect(
        name="kt_drift",
        title="drift of the torque constant",
        equation="tau = (1 + rate t / 100 s) tau_cmd",
        parameters=(Parameter(name="rate", unit="1/(100 s)", neutral=0.0, low=-0.9, high=2.0, step=0.02, spread=20),),
        signature="grows with time, whatever the load",
        experiment="the same motion at start and end",
        enters="actuator_gainprm, actuator_biasprm at every step",
        source="DC motor, tau = Kt i",
    ),
    Effect(
        name="kt_heat",
        title="torque constant falling with heat",
        equation="tau = (1 - loss h) tau_cmd, dh/dt = (tau^2 - h) / time",
        parameters=(
            Parameter(name="loss", unit="1/(N m)^2", neutral=0.0, low=0.0, high=0.5, step=0.01, spread=50),
            Parameter(
                name="time",
                unit="s",
                neutral=40.0,
                low=5.0,
                high=300.0,
                step=10.0,
                starts=(1.5, 4.0, 10.0),
                shape=True,
                spread=20,
            ),
        ),
        signature="slow growth after work, recovery after rest",
        experiment="the same motion before and after hard work, and after a pause",
        enters="actuator_gainprm, actuator_biasprm at every step; dcmotor thermal in MJCF",
        source="magnets lose flux with temperature; MuJoCo documentation, dcmotor",
    ),
    Effect(
        name="torque_lag",
        title="lag of the current loop",
        equation="time dtau/dt + tau = tau_cmd",
        parameters=(
            Parameter(
                name="time", unit="s", neutral=0.0, low=0.0, high=0.05, step=0.0005, spread=40, starts=(4.0, 16.0, 30.0)
            ),
        ),
        signature="phase lag that grows with frequency, not with the target",
        experiment="chirp and steps",
        enters="actuator bias at every step; dcmotor inductance in MJCF",
        source="first-order current loop",
    ),
    Effect(
        name="velocity_lag",
        title="velocity filter of the drive",
        equation="the Kd term sees w, time dw/dt + w = v",
        parameters=(
            Parameter(
                name="time", unit="s", neutral=0.0, low=0.0, high=0.05, step=0.0005, spread=40, starts=(4.0, 16.0)
            ),
        ),
        signature="less damping, ringing after steps",
        experiment="steps with a high Kd",
        enters="actuator bias at every step",
        source="first-order low-pass in the drive",
    ),
    # ---------------------------------------------------------------- friction
    Effect(
        name="stribeck",
        title="Stribeck friction",
        equation="tau = -level exp(-(v/speed)^2) sgn(v), beside dry friction",
        parameters=(
            Parameter(name="level", unit="N m", neutral=0.0, low=0.0, high=50.0, step=0.01, starts=(15.0,)),
            Parameter(
                name="speed",
                unit="rad/s",
                neutral=0.1,
                low=0.005,
                high=2.0,
                step=0.01,
                starts=(2.0, 6.0, 20.0),
                shape=True,
                spread=30,
            ),
        ),
        structural=True,
        signature="spikes at each start, stick-slip",
        experiment="repeat with slow ramps below 0.05 rad/s and small reversals",
        enters="dof_frictionloss at every step; dcmotor lugre in MJCF",
        source="Stribeck 1902; Armstrong-Helouvry et al. 1994",
    ),
    Effect(
        name="load_friction",
        title="load-dependent friction",
        equation="tau = -ratio |tau_motor| sgn(v), beside dry friction",
        parameters=(Parameter(name="ratio", unit="1", neutral=0.0, low=0.0, high=0.9, step=0.02, spread=25),),
        signature="friction grows in loaded poses",
        experiment="reversals under several loads",
        enters="dof_frictionloss at every step",
        source="gear efficiency; Duclos et al., bam, 2025",
    ),
    Effect(
        name="asymmetric_friction",
        title="asymmetric friction",
        equation="tau = -level - coefficient |v|, beside dry (at most as much of it, at rest too) and viscous friction",
        parameters=(
            Parameter(name="level", unit="N m", neutral=0.0, low=-50.0, high=50.0, step=0.01),
            Parameter(name="coefficient", unit="N m s/rad", neutral=0.0, low=-500.0, high=500.0, step=0.01),
        ),
        signature="mean error differs between the two directions",
        experiment="equal ramps both ways",
        enters="dof_frictionloss and qfrc_applied at every step",
        source="Janot, Gautier, Brunot 2019, EMPS",
    ),
    Effect(
        name="quadratic_drag",
        title="quadratic drag",
        equation="tau = -coefficient v |v|",
        parameters=(Parameter(name="coefficient", unit="N m s^2/rad^2", neutral=0.0, low=0.0, high=50.0, step=0.01),),
        signature="lag that grows with the square of speed",
        experiment="fast sines",
        enters="qfrc_applied at every step; damping polynomial in MJCF",
        source=_CAL,
    ),
    Effect(
        name="coupling",
        title="coupling to the neighbouring joint",
        equation="tau = -coefficient v of the next joint of the chain (of the one before, for the last)",
        parameters=(Parameter(name="coefficient", unit="N m s/rad", neutral=0.0, low=-50.0, high=50.0, step=0.01),),
        signature="residual follows the other joint's speed",
        experiment="one joint at a time, then together",
        enters="qfrc_applied at every step",
        source="belts, shared bearings and cable looms",
    ),
    # ---------------------------------------------------------------- transmission
    Effect(
        name="backlash",
        title="backlash",
        equation="motor and link move freely against each other within gap; the encoder is on the motor",
        parameters=(
            Parameter(name="gap", unit="rad", neutral=0.0, low=0.0, high=0.3, step=0.004, starts=GAPS, spread=100),
        ),
        structural=True,
        signature="dwell at each reversal of torque",
        experiment="small reversals around zero load, and the same preloaded by gravity",
        enters="rotor state in the law, implicit in the actuator bias",
        source="Nordin and Gutman 2002",
    ),
    Effect(
        name="compliance",
        title="joint compliance",
        equation="tau = (theta - q) / compliance between motor angle theta and link; the encoder is on the motor",
        parameters=(
            Parameter(
                name="compliance",
                unit="rad/(N m)",
                neutral=0.0,
                low=0.0,
                high=0.2,
                step=0.003,
                starts=(3.0, 12.0),
                spread=50,
            ),
        ),
        structural=True,
        signature="a resonance; reads as delay without friction",
        experiment="chirp through the resonance, and a second log with a higher Kp",
        enters="rotor state in the law, implicit in the actuator bias",
        source="Spong 1987",
    ),
    # ---------------------------------------------------------------- encoder
    Effect(
        name="encoder_offset",
        title="encoder offset",
        equation="reading = q + angle",
        parameters=(Parameter(name="angle", unit="rad", neutral=0.0, low=-1.0, high=1.0, step=0.01, spread=50),),
        signature="constant in the reading, so that only gravity and limits show it",
        experiment="wide static poses, or a touch of the end stop",
        enters="target and reading",
        source="zero of the encoder",
    ),
    Effect(
        name="encoder_scale",
        title="encoder scale",
        equation="reading = factor q",
        parameters=(Parameter(name="factor", unit="1", neutral=1.0, low=0.5, high=2.0, step=0.01, spread=10),),
        signature="as gravity and inertia of a scaled motion",
        experiment="wide static poses",
        enters="target, reading and gains",
        source="gear ratio or calibration table of the encoder",
    ),
    Effect(
        name="encoder_step",
        title="coarse encoder",
        equation="reading = angle round(q / angle)",
        parameters=(Parameter(name="angle", unit="rad", neutral=0.0, low=0.0, high=0.1, step=0.001, fixed=True),),
        signature="steps of equal size in the reading",
        experiment="slow ramps",
        enters="reading and actuator bias at every step",
        source="resolution of the encoder",
    ),
    # ---------------------------------------------------------------- forces that depend on position or time
    Effect(
        name="cogging",
        title="cogging",
        equation="tau = cosine cos(order q) + sine sin(order q)",
        parameters=(
            Parameter(name="cosine", unit="N m", neutral=0.0, low=-20.0, high=20.0, step=0.01),
            Parameter(name="sine", unit="N m", neutral=0.0, low=-20.0, high=20.0, step=0.01),
            Parameter(name="order", unit="1/rad", neutral=20.0, low=2.0, high=400.0, step=0.02, shape=True, spread=50),
        ),
        signature="a peak in the spectrum over position",
        experiment="slow ramps over the whole range",
        enters="qfrc_applied at every step; dcmotor cogging in MJCF",
        source="poles and slots times the gear ratio",
    ),
    Effect(
        name="spring",
        title="spring or cable pull",
        equation="tau = moment - stiffness q",
        parameters=(
            Parameter(name="stiffness", unit="N m/rad", neutral=0.0, low=-200.0, high=200.0, step=0.01),
            Parameter(name="moment", unit="N m", neutral=0.0, low=-200.0, high=200.0, step=0.01),
        ),
        signature="linear in the joint's own position, whatever the pose of the others",
        experiment="static sweep of one joint at a time",
        enters="qfrc_applied at every step; joint stiffness in MJCF",
        source=_CAL,
    ),
    Effect(
        name="base_tilt",
        title="tilted base",
        equation="base turned by roll about x, then pitch about y, gravity the other way",
        parameters=(
            Parameter(name="roll", unit="rad", neutral=0.0, low=-0.8, high=0.8, step=0.03, spread=20),
            Parameter(name="pitch", unit="rad", neutral=0.0, low=-0.8, high=0.8, step=0.03, spread=20),
        ),
        scope="machine",
        signature="all joints, in a fixed pattern over the pose",
        experiment="static poses; an IMU reading",
        enters="opt.gravity",
        source="mounting of the robot",
    ),
    Effect(
        name="payload",
        title="payload at the end of the limb",
        equation="a point of mass at the tip of the last link",
        tip=True,
        parameters=(Parameter(name="mass", unit="kg", neutral=0.0, low=0.0, high=5.0, step=0.01, spread=20),),
        signature="follows gravity over the pose of the whole limb, and acceleration",
        experiment="static poses and a chirp",
        enters="body_mass, body_inertia, body_ipos",
        source="rigid body",
    ),
    Effect(
        name="com_shift",
        title="shifted centre of mass of a link",
        equation="centre of mass of the link moved by distance toward its end",
        parameters=(Parameter(name="distance", unit="m", neutral=0.0, low=-0.15, high=0.15, step=0.003, spread=10),),
        signature="follows gravity over the pose",
        experiment="static poses and a chirp",
        enters="body_ipos",
        source="rigid body",
    ),
    Effect(
        name="periodic_force",
        title="external periodic force",
        equation="tau = cosine cos(2 pi frequency t) + sine sin(2 pi frequency t)",
        parameters=(
            Parameter(name="cosine", unit="N m", neutral=0.0, low=-20.0, high=20.0, step=0.01),
            Parameter(name="sine", unit="N m", neutral=0.0, low=-20.0, high=20.0, step=0.01),
            Parameter(name="frequency", unit="Hz", neutral=1.0, low=0.05, high=50.0, step=0.002, shape=True, spread=50),
        ),
        signature="a narrow peak in the spectrum over time, whatever the robot does",
        experiment="hold still and log",
        enters="qfrc_applied at every step",
        source="fans, pumps, a person at the stand",
    ),
    # ---------------------------------------------------------------- commands
    Effect(
        name="joint_delay",
        title="extra delay of a joint",
        equation="the target of this joint acts time later than those of the others",
        parameters=(
            Parameter(name="time", unit="s", neutral=0.0, low=0.0, high=0.1, step=0.001, spread=30, starts=(4.0, 12.0)),
        ),
        signature="residual of one joint in proportion to the speed of its target",
        experiment="steps and a chirp",
        enters="command path; actuator delay in MJCF",
        source="place on the bus",
    ),
    Effect(
        name="delay_jitter",
        title="jittering delay",
        equation="each target acts later by a time drawn between 0 and spread",
        parameters=(Parameter(name="spread", unit="s", neutral=0.0, low=0.0, high=0.1, step=0.002),),
        scope="machine",
        random=True,
        signature="bursts on the grid of the targets, in proportion to their change",
        experiment="arrival times in the log",
        enters="command path",
        source="a computer without real time",
    ),
    Effect(
        name="lost_commands",
        title="lost commands",
        equation="each target is lost with probability share; the one before stays",
        parameters=(Parameter(name="share", unit="1", neutral=0.0, low=0.0, high=0.9, step=0.01),),
        scope="machine",
        random=True,
        signature="bursts on the grid of the targets, as if a target had been left out",
        experiment="frame counters in the log",
        enters="command path",
        source="bus errors",
    ),
)

CATALOGUE: Mapping[str, Effect] = {effect.name: effect for effect in _ALL}
"""Every effect by name."""

BASELINE = tuple(e.name for e in _ALL if e.baseline)
"""Effects that every model has: friction, damping, limb mass, delay. Source: Li et al. 2024, section IV."""


_LINEAR = {
    "N m": "N",
    "N m/rad": "N/m",
    "N m s/rad": "N s/m",
    "N m s^2/rad^2": "N s^2/m^2",
    "rad/(N m)": "m/N",
    "1/(N m)^2": "1/N^2",
    "kg m^2": "kg",
    "rad": "m",
    "rad/s": "m/s",
    "1/rad": "1/m",
}


def unit_of(name: str, parameter: str, positions: str = "rad") -> str:
    """Return the unit of a parameter, nothing where it has none, for joints that turn (rad) or slide (m)."""
    spec = effect(name)
    unit = spec.parameter(parameter).unit
    if positions == "m" and spec.scope == "joint":
        unit = _LINEAR.get(unit, unit)
    return "" if unit == "1" else unit


def scale_of(unit: str, position: float, speed: float, acceleration: float, torque: float) -> float:
    """Return how large a number of this unit is on a machine whose motion and torque have these root mean squares.

    1 for units without a scale.
    """
    return {
        "N m": torque,
        "N m s/rad": torque / speed,
        "N m s^2/rad^2": torque / speed**2,
        "N m/rad": torque / position,
        "kg m^2": torque / acceleration,
        "1/(N m)^2": 1.0 / torque**2,
        "rad/(N m)": position / torque,
        "rad": position,
        "rad/s": speed,
    }.get(unit, 1.0)


def effect(name: str) -> Effect:
    """Return an effect by name.

    Raises:
        UnknownEffect: If the catalogue does not have it.
    """
    if name not in CATALOGUE:
        raise UnknownEffect(name)
    return CATALOGUE[name]
