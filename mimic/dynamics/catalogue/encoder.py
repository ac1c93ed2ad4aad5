"""What the encoder says, and where the joint is."""

from mimic.dynamics.catalogue.kinds import Effect, Parameter

ENCODER = (
    Effect(
        name="encoder_offset",
        title="encoder offset",
        equation="reading = q + angle",
        parameters=(Parameter("angle", "rad", low=-1.0, high=1.0, step=0.01, spread=50),),
        signature="constant in the reading, so that only gravity and limits show it",
        experiment="wide static poses, or a touch of the end stop",
        enters="target and reading",
        source="zero of the encoder",
    ),
    Effect(
        name="encoder_scale",
        title="encoder scale",
        equation="reading = factor q",
        parameters=(Parameter("factor", "1", neutral=1.0, low=0.5, high=2.0, step=0.01, spread=3),),
        signature="as gravity and inertia of a scaled motion",
        experiment="wide static poses",
        enters="target, reading and gains",
        source="gear ratio or calibration table of the encoder",
    ),
    Effect(
        name="encoder_step",
        title="coarse encoder",
        equation="reading = angle round(q / angle)",
        parameters=(Parameter("angle", "rad", low=0.0, high=0.1, step=0.001, fixed=True),),
        signature="steps of equal size in the reading",
        experiment="slow ramps",
        enters="reading and torque of the motor at every step",
        source="resolution of the encoder",
    ),
    Effect(
        name="encoder_eccentricity",
        title="eccentric encoder",
        equation="reading = q + cosine cos(q) + sine sin(q); the drive damps by the true speed",
        parameters=(
            Parameter("cosine", "rad", low=-0.2, high=0.2, step=0.01, spread=30),
            Parameter("sine", "rad", low=-0.2, high=0.2, step=0.01, spread=30),
        ),
        signature="an offset that turns with the joint; small motions show an offset and a scale",
        experiment="static poses over the whole range",
        enters="reading and torque of the motor at every step",
        source="a magnet or disc beside the axis",
    ),
)
