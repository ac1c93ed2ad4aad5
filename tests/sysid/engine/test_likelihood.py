"""Scales of innovations are those of maximum likelihood."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.optimize import minimize_scalar
from scipy.stats import t as student

from mimic.sysid.engine.likelihood import FREEDOM, scales


def one_log(count: int) -> Any:
    record = SimpleNamespace(log=np.zeros(count, dtype=int))
    counts = np.ones((count, 1), dtype=bool)
    return SimpleNamespace(logs=1, joints=1, record=record, counts=counts, noise=np.full(1, 1e-12))


@pytest.mark.parametrize("share", [0.0, 0.12, 0.2, 0.4])
@pytest.mark.parametrize("larger", [10.0, 1e4])
def test_the_scale_is_the_likeliest_where_some_readings_are_far_off(share: float, larger: float) -> None:
    rng = np.random.default_rng(3)
    e = 1e-4 * rng.standard_normal(1500)
    e[: round(share * len(e))] *= larger  # a robot that rests for most of a log, and moves otherwise than predicted

    def unlikely(log_scale: float) -> float:
        return -float(student.logpdf(e, FREEDOM, scale=np.exp(log_scale)).sum())

    likeliest = minimize_scalar(
        unlikely, bounds=(np.log(1e-6), np.log(10.0)), method="bounded", options={"xatol": 1e-6}
    )
    assert scales(e[:, None], one_log(len(e)))[0, 0] == pytest.approx(np.exp(likeliest.x), rel=1e-3)
