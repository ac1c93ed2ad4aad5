"""Forces that depend on position or time, and masses."""

from mimic.dynamics.catalogue.kinds import STANDARD, Effect, Parameter

FORCES = (
    Effect(
        name="cogging",
        title="cogging",
        equation="tau = cosine cos(order q) + sine sin(order q)",
        parameters=(
            Parameter("cosine", "N m", low=-20.0, high=20.0, step=0.01),
            Parameter("sine", "N m", low=-20.0, high=20.0, step=0.01),
            Parameter(
                "order", "1/rad", neutral=20.0, low=2.0, high=400.0, step=0.02, shape=True, spread=50, spectral=True
            ),
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
            Parameter("stiffness", "N m/rad", low=-200.0, high=200.0, step=0.01),
            Parameter("moment", "N m", low=-200.0, high=200.0, step=0.01),
        ),
        signature="linear in the joint's own position, whatever the pose of the others",
        experiment="static sweep of one joint at a time",
        enters="qfrc_applied at every step; joint stiffness in MJCF",
        source=STANDARD,
    ),
    Effect(
        name="base_tilt",
        title="tilted base",
        equation="base turned by roll about x, then pitch about y, gravity the other way",
        parameters=(
            Parameter("roll", "rad", low=-0.8, high=0.8, step=0.03, spread=20),
            Parameter("pitch", "rad", low=-0.8, high=0.8, step=0.03, spread=20),
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
        parameters=(Parameter("mass", "kg", low=0.0, high=5.0, step=0.01, spread=20),),
        signature="follows gravity over the pose of the whole limb, and acceleration",
        experiment="static poses and a chirp",
        enters="body_mass, body_inertia, body_ipos",
        source="rigid body",
    ),
    Effect(
        name="com_shift",
        title="shifted centre of mass of a link",
        equation="centre of mass of the link moved by distance toward its end",
        parameters=(Parameter("distance", "m", low=-0.15, high=0.15, step=0.003, spread=10, tolerance=0.02),),
        signature="follows gravity over the pose",
        experiment="static poses and a chirp",
        enters="body_ipos",
        source="rigid body",
    ),
)
