"""What every model has, fitted first: friction, damping, limb mass, delay. Source: Li et al. 2024, section IV."""

from mimic.dynamics.catalogue.kinds import MODEL, Effect, Parameter

BASELINE = (
    Effect(
        name="coulomb",
        title="dry friction",
        equation="tau = -level sgn(v), up to level while at rest",
        parameters=(Parameter("level", "N m", neutral=MODEL, low=0.0, high=50.0, step=0.01),),
        signature="lag at every reversal",
        experiment="slow ramps against fast sines",
        enters="dof_frictionloss",
        source="Coulomb 1785; MuJoCo documentation, frictionloss",
    ),
    Effect(
        name="viscous",
        title="viscous friction",
        equation="tau = -coefficient v",
        parameters=(Parameter("coefficient", "N m s/rad", neutral=MODEL, low=0.0, high=500.0, step=0.01),),
        signature="lag in proportion to speed",
        experiment="fast sines; a second log with another Kd tells it from Kd",
        enters="dof_damping",
        source="MuJoCo documentation, damping",
    ),
    Effect(
        name="link_mass",
        title="mass of the moved link",
        equation="mass and inertia of the link times factor",
        parameters=(Parameter("factor", "1", neutral=1.0, low=0.3, high=3.0, step=0.03, spread=5),),
        signature="error that follows gravity over the pose, and acceleration",
        experiment="static poses and a chirp",
        enters="body_mass, body_inertia",
        source="Li et al. 2024, Table II",
    ),
    Effect(
        name="delay",
        title="command delay",
        equation="the target acts time later",
        parameters=(Parameter("time", "s", low=-0.01, high=0.1, step=0.001, spread=30),),
        scope="machine",
        signature="residual in proportion to the speed of the target",
        experiment="steps and a chirp",
        enters="command path; actuator delay in MJCF",
        source="Li et al. 2024, section IV",
    ),
)
