"""Settings: one module for each flow, frozen dataclasses. Numbers of the robot are in assets/, not here."""
