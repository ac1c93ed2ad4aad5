"""What is between motor and link."""

from mimic.dynamics.catalogue.kinds import Effect, Parameter

GAPS = tuple(2.5 * 1.2**k for k in range(19))
"""Starts of a backlash, in differences that matter: a fit finds one only from within a sixth of it."""

STIFFEST = 2e-4
"""Compliance of a transmission that has backlash only [rad/(N m)]: stiff against any position gain in use."""

DAMPING_RATIO = 0.2
"""Of the rotor against its transmission, where nothing is known; steel gears ring for a few periods."""

TRANSMISSION = (
    Effect(
        name="backlash",
        title="backlash",
        equation="motor and link move freely within gap, then give by compliance; the encoder is on the motor",
        parameters=(
            Parameter("gap", "rad", low=0.0, high=0.3, step=0.004, starts=GAPS, spread=100),
            Parameter(
                "compliance", "rad/(N m)", neutral=STIFFEST, low=1e-5, high=0.01, step=0.003, shape=True, spread=1
            ),
        ),
        structural=True,
        signature="dwell at each reversal of torque",
        experiment="small reversals around zero load, and the same preloaded by gravity",
        enters="rotor state in the law, implicit in the torque and inertia of the joint",
        source="Nordin and Gutman 2002",
    ),
    Effect(
        name="compliance",
        title="joint compliance",
        equation="tau = (theta - q) / compliance + 2 damping sqrt(armature / compliance) d(theta - q)/dt between motor"
        " angle theta and link; the encoder is on the motor",
        parameters=(
            Parameter("compliance", "rad/(N m)", low=0.0, high=0.2, step=0.003, starts=(3.0, 12.0), spread=50),
            Parameter("damping", "1", neutral=DAMPING_RATIO, low=0.01, high=2.0, step=0.02, shape=True, spread=10),
        ),
        structural=True,
        signature="a resonance; reads as delay without friction",
        experiment="chirp through the resonance, and a second log with a higher Kp",
        enters="rotor state in the law, implicit in the torque and inertia of the joint",
        source="Spong 1987",
    ),
)
