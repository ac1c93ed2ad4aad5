"""Identification by the innovations of one pass over a log, with an unknown torque in each joint as the rival.

``tree`` is the rigid machine, ``laws`` what its drives do, ``predictor`` the pass; ``data`` is what logs give,
``model`` a set of free numbers fitted by maximum likelihood, ``screen`` and ``search`` find the effects.

Source: Ljung, System Identification, 1999, chapter 7 (prediction errors, innovations form); Kennedy and O'Hagan 2001
(a model and its discrepancy).
"""
