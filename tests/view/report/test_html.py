"""A calibration made up for the page: what it says must be on it."""

from __future__ import annotations

import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

from mimic.dynamics.effect_set import EffectSet, EffectValues
from mimic.sysid.result import (
    Alternative,
    Calibration,
    Candidate,
    Correlations,
    Errors,
    Found,
    Stage,
    Traces,
    UnexplainedResidual,
)
from mimic.view.report.html import html_report, write_report

JOINTS = ("FL_abad", "FL_hip", "FL_knee", "FR_abad", "FR_hip", "FR_knee")


def made_up(seconds: float = 60.0, unit: str = "rad") -> Calibration:
    """Return a calibration that found Stribeck friction and cannot tell backlash from it in a second stage."""
    rng = np.random.default_rng(0)
    t = np.arange(0.0, seconds, 0.005)
    n = len(JOINTS)
    phase = np.arange(n)
    q = 0.5 * np.sin(2 * np.pi * (0.05 + 0.02 * t[:, None]) * t[:, None] / 10 + phase)
    dq = np.gradient(q, t, axis=0)
    noise = np.full(n, 4.1e-4)
    white = noise * rng.standard_normal((len(t), n))
    before = (
        white + 2.5e-3 * np.tanh(dq / 0.05) * np.exp(-((dq / 0.3) ** 2)) + 4e-4 * np.sin(2 * np.pi * 9 * t)[:, None]
    )
    after = white + 3e-4 * np.sin(2 * np.pi * 9 * t)[:, None] * (phase == 2)

    def errors(scale: float) -> Errors:
        return Errors(train=scale * noise * (1 + 0.02 * phase), held_out=scale * noise * (1.05 + 0.02 * phase))

    row = {k: np.full(n, v) for k, v in {"level": 0.213, "speed": 0.118}.items()}
    interval = {k: np.stack([0.9 * v, 1.1 * v], -1) for k, v in row.items()}
    return Calibration(
        joints=JOINTS,
        unit=unit,
        noise=noise,
        nominal=errors(16.4),
        baseline=errors(4.4),
        final=errors(1.07),
        found=(
            Found(name="stribeck", joints=JOINTS, evidence=812.0, share=0.93),
            Found(name="armature", joints=JOINTS, evidence=47.0, share=0.04),
        ),
        alternatives=(Alternative(effects=(("stribeck", JOINTS), ("torque_lag", JOINTS[:2])), behind=3.1),),
        tried=(
            Stage(
                beside=(),
                candidates=tuple(
                    Candidate(name=name, joints=JOINTS[:3], gain=gain, fitted=gain > 100.0)
                    for name, gain in (
                        ("stribeck", 812.0),
                        ("backlash", 310.0),
                        ("load_friction", 60.0),
                        ("encoder_offset", 1.2),
                        ("kt_gain", 0.9),
                        ("cogging", 0.3),
                        ("quadratic_drag", -7.6),
                    )
                ),
            ),
        ),
        effects=EffectSet(
            (
                EffectValues(name="coulomb", joints=JOINTS, values={"level": 0.31}, role="fitted"),
                EffectValues(name="delay", values={"time": 0.0123}, intervals={"time": np.array([[0.0121, 0.0125]])}),
                EffectValues(name="stribeck", joints=JOINTS, values=row, intervals=interval, role="fitted"),
                EffectValues(name="armature", joints=JOINTS, values={"inertia": 0.0061}, role="fitted"),
            )
        ),
        unexplained=tuple(
            UnexplainedResidual(
                joint=j,
                ratio=2.3 if i == 2 else 1.06,
                torque=0.4,
                depends_on=(("position of FL_hip", 0.31),) if i == 2 else (),
            )
            for i, j in enumerate(JOINTS)
        ),
        sentence="The model lacked Stribeck friction and rotor inertia (held-out error 1.90 mrad → 0.46 mrad).",
        experiments=("reflected rotor inertia: chirp to 8-10 Hz", "lag of the current loop: chirp and steps"),
        warnings=("about 12 readings are missing (0.1%)",),
        traces=Traces(
            t=t,
            q=q,
            dq=dq,
            tau=4 * np.sin(3 * q) + 0.3 * dq,
            before=before,
            after=after,
            target=q + 0.02,
        ),
        passes=5321,
        seconds=73.4,
        metadata={"name": "probe.parquet", "rate": 200.0, "log": {"kp": 30.0, "kd": 3.0}},
    )


class Page(HTMLParser):
    """What stands on a page, and whether every tag is closed."""

    VOID = ("meta", "br")

    def __init__(self, page: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.text = ""
        self.links: list[str] = []
        self.tags: list[str] = []
        self.feed(page)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.links += [v or "" for k, v in attrs if k in ("href", "src", "xlink:href")]
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag, f"</{tag}> closes another tag"

    def handle_data(self, data: str) -> None:
        if self.open and self.open[-1] not in ("style", "title"):
            self.text += data + " "


@pytest.fixture(scope="module")
def calibration() -> Calibration:
    return made_up()


@pytest.fixture(scope="module")
def page(calibration: Calibration) -> Page:
    return Page(html_report(calibration))


def test_the_page_is_whole_and_loads_nothing(calibration: Calibration, page: Page) -> None:
    assert page.open == []
    assert page.links == []
    assert "script" not in page.tags
    assert not re.search(r"url\(|@import|https?://", html_report(calibration))


def test_it_is_small(calibration: Calibration) -> None:
    long = replace(calibration, traces=made_up(seconds=240.0).traces)
    assert len(html_report(long)) < 1_500_000


def test_the_verdict_and_every_finding_stand_on_it(calibration: Calibration, page: Page) -> None:
    assert calibration.sentence in page.text
    for line in (*calibration.experiments, *calibration.warnings):
        assert line in page.text
    assert "cannot rule out" in page.text
    assert "lag of the current loop in FL_abad, FL_hip" in page.text
    assert "−7.6" in page.text
    assert "position of FL_hip" in page.text
    for joint in JOINTS:
        assert page.text.count(joint) >= 8


def test_errors_are_in_a_readable_unit(page: Page) -> None:
    assert "mrad" in page.text
    small = made_up(unit="m")
    little = Errors(train=1e-3 * small.noise, held_out=1e-3 * small.noise)
    tiny = replace(small, nominal=little, baseline=little, final=little)
    sliding = Page(html_report(tiny)).text
    assert "µm" in sliding
    assert "[N s/m]" not in sliding
    assert "[kg]" in sliding
    assert "N m" not in sliding.replace("tau", "")


def test_values_have_units_and_intervals(page: Page) -> None:
    assert "0.213" in page.text
    assert "0.192 … 0.234" in page.text
    assert "N m" in page.text
    assert "tau = -level exp(-(v/speed)^2) sgn(v), beside dry friction" in page.text


def test_each_joint_has_its_plots(calibration: Calibration, page: Page) -> None:
    n = len(JOINTS)
    assert page.tags.count("svg") == n + n + 3 * n + n


def test_a_log_of_another_machine_is_said_first(calibration: Calibration) -> None:
    page = Page(html_report(replace(calibration, log_matches_model=False, tried=())))
    assert page.text.index("does not match the model") < page.text.index(calibration.sentence)
    assert "Evidence" not in page.text


def test_nothing_found_is_said(calibration: Calibration) -> None:
    alone = EffectSet(tuple(calibration.effects)[:2])
    page = Page(html_report(replace(calibration, found=(), alternatives=(), effects=alone)))
    assert "No effect improved on the baseline model" in page.text


def test_names_are_escaped(calibration: Calibration) -> None:
    page = Page(html_report(replace(calibration, sentence="a < b & c", metadata={"name": "<script>"})))
    assert "a < b & c" in page.text
    assert "script" not in page.tags


def test_missing_readings_and_unknown_intervals_do_no_harm(calibration: Calibration) -> None:
    after = np.array(calibration.traces.after)
    after[100:400] = np.nan
    unknown = EffectValues(name="delay", values={"time": 0.01}, intervals={"time": np.full((1, 2), np.nan)})
    effects = EffectSet((unknown,))
    page = html_report(replace(calibration, found=(), traces=replace(calibration.traces, after=after), effects=effects))
    assert "nan" not in re.sub(r"<style>.*?</style>", "", page, flags=re.S)


def test_the_file_is_the_page(calibration: Calibration, tmp_path: Path) -> None:
    path = write_report(calibration, tmp_path / "report.html")
    assert path.read_text(encoding="utf-8") == html_report(calibration)
    assert list(tmp_path.iterdir()) == [path]


def test_a_number_on_its_bound_is_marked(calibration: Calibration) -> None:
    heavy = EffectValues(name="link_mass", joints=JOINTS, values={"factor": [3.0, 1.0, 1.0, 0.3, 1.0, 1.0]})
    page = html_report(replace(calibration, effects=EffectSet((heavy,)), found=()))
    assert page.count("at its bound: do not") == 2


def test_measured_torque_has_plots_of_its_own_where_it_was_explained(calibration: Calibration, page: Page) -> None:
    traces = replace(
        calibration.traces, torque_before=calibration.traces.tau, torque_after=0.1 * calibration.traces.tau
    )
    more = Page(html_report(replace(calibration, traces=traces)))
    assert more.tags.count("svg") == page.tags.count("svg") + len(JOINTS)
    assert "Residual of the measured torque" in more.text
    assert "Residual of the measured torque" not in page.text


def test_correlated_numbers_are_listed_and_mapped(calibration: Calibration, page: Page) -> None:
    assert "Correlation of the fitted numbers" not in page.text
    names = ("coulomb.level of FL_hip", "link_mass.factor of FL_hip", "delay.time")
    matrix = np.array([[1.0, -0.91, 0.02], [-0.91, 1.0, 0.3], [0.02, 0.3, 1.0]])
    more = html_report(replace(calibration, correlations=Correlations(names=names, matrix=matrix)))
    text = Page(more).text
    assert "−0.91" in text
    assert "delay.time with link_mass.factor of FL_hip: 0.30" in more
    assert len(re.findall("<td class=name>coulomb.level of FL_hip</td>", more)) == 1
    weak = Correlations(names=names, matrix=np.eye(3))
    assert "No two numbers are correlated" in Page(html_report(replace(calibration, correlations=weak))).text


def test_errors_stand_in_degrees_and_as_mean_absolute_error(calibration: Calibration, page: Page) -> None:
    residual = np.rad2deg(calibration.traces.after)
    for size in (np.sqrt(np.mean(residual**2)), np.mean(np.abs(residual))):
        assert f"{size:.4f}" in page.text
