"""What a person does with mimic, as functions: load a motion, play it, evaluate a policy, calibrate a model.

Nothing here prints. Progress and warnings go to a `mimic.flows.reporter.Reporter` that the caller gives.
"""
