"""Identification by predictions to the end of blocks, from starts that a filter with an unknown torque finds.

``tree`` is the rigid machine, ``laws`` what its drives do, ``predictor`` the pass; ``data`` is what logs give,
``model`` a set of free numbers fitted by maximum likelihood, ``screen`` and ``search`` find the effects.

Source: Ljung, System Identification, 1999, chapter 7 (prediction errors some steps ahead); Bock 1983 (multiple
shooting); Takeuchi 1976 (evidence of a model that lacks something).
"""
