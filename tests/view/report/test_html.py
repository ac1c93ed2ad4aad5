"""A calibration made up for the page: what it says must be on it."""

from __future__ import annotations

import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

from mimic.dynamics.effect_set import EffectSet, EffectValues
from mimic.sysid.result import Calibration, Candidate, Correlations, Errors, Stage, Traces, UnexplainedResidual
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

    def candidate(name: str, gain: float, z: float, why: str = "", **values: float) -> Candidate:
        return Candidate(
            name=name,
            gain=gain,
            z=z,
            improvement=max(gain, 0) * 9,
            values={k: np.full(n, v) for k, v in values.items()},
            joints=JOINTS,
            accepted=not why,
            why=why,
            alternative_z=1.1 if why.startswith("as good") else 6.0,
        )

    row = {k: np.full(n, v) for k, v in {"level": 0.213, "speed": 0.118}.items()}
    interval = {k: np.stack([0.9 * v, 1.1 * v], -1) for k, v in row.items()}
    return Calibration(
        joints=JOINTS,
        unit=unit,
        noise=noise,
        nominal=errors(16.4),
        stages=(
            Stage(added="baseline", errors=errors(4.4)),
            Stage(
                added="stribeck",
                errors=errors(1.5),
                candidates=(
                    candidate("stribeck", 1.21, 14.2, level=0.21, speed=0.12),
                    candidate("backlash", 0.42, 6.1, "another effect gains more", gap=0.004),
                    candidate("load_friction", 0.11, 4.0, "another effect gains more", ratio=0.05),
                    candidate("encoder_offset", 0.006, 1.2, "z 1.2 is below 3", angle=0.002),
                    candidate("kt_gain", 0.012, 0.9, "z 0.9 is below 3", factor=1.04),
                    candidate("cogging", 0.001, 0.3, "gain below 1 %", cosine=0.004, sine=0.001, order=20.0),
                    candidate("quadratic_drag", -0.004, -0.8, "worse on held-out blocks", coefficient=0.001),
                ),
            ),
            Stage(
                added="armature",
                errors=errors(1.07),
                candidates=(
                    candidate("armature", 0.31, 9.0, inertia=0.0061),
                    candidate("torque_lag", 0.29, 7.7, "as good as the chosen one", time=0.0021),
                ),
                alternatives=("torque_lag",),
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
                state_r2=-0.12,
                depends_on=(),
                peak_hz=9.0 if i == 2 else 3.1,
                peak_ratio=412.0 if i == 2 else 2.4,
                verdict="periodic" if i == 2 else "explained",
            )
            for i, j in enumerate(JOINTS)
        ),
        sentence="The model lacked Stribeck friction and rotor inertia (held-out error 1.90 mrad → 0.46 mrad).",
        experiments=("reflected rotor inertia: chirp to 8-10 Hz", "lag of the current loop: chirp and steps"),
        warnings=("about 12 readings are missing (0.1%)",),
        traces=Traces(
            t=t,
            held_out=(t // 1.5).astype(int) % 4 == 2,
            q=q,
            dq=dq,
            tau=4 * np.sin(3 * q) + 0.3 * dq,
            before=before,
            after=after,
            target=q + 0.02,
        ),
        replays=5321,
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
    assert "cannot be ruled out" in page.text
    assert "z 1.2 is below 3" in page.text
    assert "near 9 Hz" in page.text
    for joint in JOINTS:
        assert page.text.count(joint) >= 8


def test_errors_are_in_a_readable_unit(page: Page) -> None:
    assert "mrad" in page.text
    small = made_up(unit="m")
    tiny = replace(small, nominal=Errors(train=1e-3 * small.noise, held_out=1e-3 * small.noise), stages=())
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
    assert page.tags.count("svg") == n + n + 3 * n + n + 1
    without = page.tags.count("rect")
    nothing_held = replace(calibration.traces, held_out=np.zeros(len(calibration.traces.t), dtype=bool))
    assert Page(html_report(replace(calibration, traces=nothing_held))).tags.count("rect") == 0 < without


def test_a_log_of_another_machine_is_said_first(calibration: Calibration) -> None:
    page = Page(html_report(replace(calibration, log_matches_model=False, stages=calibration.stages[:1])))
    assert page.text.index("does not match the model") < page.text.index(calibration.sentence)
    assert "Evidence" not in page.text


def test_nothing_found_is_said(calibration: Calibration) -> None:
    tried = replace(calibration.stages[1], added="", candidates=calibration.stages[1].candidates[3:])
    alone = EffectSet(tuple(calibration.effects)[:2])
    page = Page(html_report(replace(calibration, stages=(calibration.stages[0], tried), effects=alone)))
    assert "no effect accepted" in page.text
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
    page = html_report(replace(calibration, traces=replace(calibration.traces, after=after), effects=effects))
    assert "nan" not in re.sub(r"<style>.*?</style>", "", page, flags=re.S)


def test_the_file_is_the_page(calibration: Calibration, tmp_path: Path) -> None:
    path = write_report(calibration, tmp_path / "report.html")
    assert path.read_text(encoding="utf-8") == html_report(calibration)
    assert list(tmp_path.iterdir()) == [path]


def test_a_number_on_its_bound_is_marked(calibration: Calibration) -> None:
    heavy = EffectValues(name="link_mass", joints=JOINTS, values={"factor": [3.0, 1.0, 1.0, 0.3, 1.0, 1.0]})
    page = html_report(replace(calibration, effects=EffectSet((heavy,))))
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
    held = calibration.traces.held_out
    residual = np.rad2deg(calibration.traces.after[held])
    for size in (np.sqrt(np.mean(residual**2)), np.mean(np.abs(residual))):
        assert f"{size:.4f}" in page.text
