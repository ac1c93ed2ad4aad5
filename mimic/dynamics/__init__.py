"""Physics of the robot and its drives: model, motor law, the catalogue of effects, heat."""
