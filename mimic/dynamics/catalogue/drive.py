"""Effects of the drive: gains, limits, lags, heat."""

from mimic.dynamics.catalogue.kinds import MODEL, Effect, Parameter

DRIVE = (
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
        name="motor",
        title="motor constants of a voltage drive",
        equation="tau = kt / resistance (V duty - kt v), duty = gain e within -1 to 1",
        parameters=(
            Parameter(name="kt", unit="N m/A", neutral=MODEL, low=0.001, high=100.0, step=0.01, spread=20),
            Parameter(name="resistance", unit="ohm", neutral=MODEL, low=0.01, high=1000.0, step=0.1, spread=20),
        ),
        signature="as gains and viscous friction together; more torque at a higher supply",
        experiment="logs with two register gains, and steps that reach full duty",
        enters="actuator_gainprm, actuator_biasprm, actuator_forcerange at every step",
        source="DC motor; the drives of hobby servos, as in Duclos et al., bam, 2025",
    ),
    Effect(
        name="torque_speed",
        title="torque limit and torque-speed line",
        equation="|tau| <= torque, and <= torque (speed - |v|) / (speed - flat) while driving",
        parameters=(
            Parameter(name="torque", unit="N m", neutral=MODEL, low=0.1, high=500.0, step=0.02, starts=(0.2, 0.4, 0.8)),
            Parameter(
                name="speed", unit="rad/s", neutral=MODEL, low=0.5, high=200.0, step=0.02, starts=(0.5, 1.2, 4.0, 100.0)
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
)
