"""Fits of simulated logs recover the parameters of the sensor."""

import math

import numpy as np
import pytest
from simulated_logs import KNOWN, STEP, is_sample, simulate, truth_of

import rendezvous_env as rv
from rendezvous_env.calibration import LogError, fit_sensor, from_tables
from rendezvous_env.calibration.blocks import Blocks, weighted_quantile
from rendezvous_env.calibration.detection import share_in_view
from rendezvous_env.calibration.errors import _components, scan_delay
from rendezvous_env.calibration.frames import find_frames
from rendezvous_env.calibration.measures import measures, unexpressed

SCALARS = [name for name in KNOWN if name != "detection"]


@pytest.fixture(scope="module")
def logs():
    return simulate(seeds=(1, 4), duration=500.0)


@pytest.fixture(scope="module")
def fits(logs):
    return [fit_sensor(from_tables(*log), seed=k) for k, log in enumerate(logs)]


def outside(fit):
    """Parameters whose interval does not hold the known value."""
    return {
        name: (one, truth_of(name))
        for name, one in fit.parameters.items()
        if not one.low <= truth_of(name) <= one.high
    }


def test_fit_recovers_each_parameter_within_its_interval(fits):
    for fit in fits:
        assert set(SCALARS) <= set(fit.parameters)
        assert not outside(fit)
        table = [one for name, one in fit.parameters.items() if name.startswith("detection")]
        assert len(table) >= 6 and all(one.high - one.low < 0.6 for one in table)


def test_intervals_are_narrow(fits):
    """Half the value or less, except for constant errors: a log has few of them."""
    for name in set(SCALARS) - {"bias", "observer_bias", "outliers", "view_falloff"}:
        one = fits[0].parameters[name]
        assert one.high - one.low < 0.5 * one.value, name
    assert fits[0].parameters["bias"].low > 0.0


@pytest.mark.nightly
def test_intervals_cover_known_parameters_in_ten_logs():
    """At 99 %, an interval misses rarely: 1 of 10 logs at most, 4 % of all."""
    missed, count = [], 0
    for seed, log in enumerate(simulate(seeds=tuple(range(10)))):
        fit = fit_sensor(from_tables(*log), seed=seed)
        missed += [name.split("[")[0] for name in outside(fit)]
        count += len(fit.parameters)
    assert len(missed) <= 0.04 * count
    assert all(missed.count(name) <= 1 for name in SCALARS)


def test_fitted_fields_make_a_sensor_that_scenarios_accept(fits):
    sensing = rv.Sensing(**fits[0].fields)
    assert sensing.sample_period == pytest.approx(0.25, rel=1e-3)
    assert sensing.outlier_kind == "uniform" and len(sensing.detection) > 5
    assert rv.Sensing(**sensing.to_plain()) == sensing
    assert rv.Scenario(n_robots=5, sensing=sensing).sensing == sensing


@pytest.mark.slow
def test_sensing_fit_takes_columns_rows_and_frames(logs):
    bearings, poses = (table[: len(table) // 6] for table in logs[0])
    named = dict(zip(("time", "observer", "target", "bearing"), bearings.T, strict=True))
    rows = rv.Sensing.fit(bearings, poses)
    assert rv.Sensing.fit(named, poses) == rows
    pandas = pytest.importorskip("pandas")
    assert rv.Sensing.fit(pandas.DataFrame(named), poses) == rows
    assert rows.noise == pytest.approx(KNOWN["noise"], rel=0.3)


def test_per_robot_levels_are_those_of_the_observers():
    sensing = {"noise": (0.01, 0.03, 0.06)}
    ((bearings, poses),) = simulate(sensing, seeds=(0,), duration=60.0, n_robots=3)
    own = rv.Sensing.fit(bearings, poses, per_robot=True).noise
    assert own == pytest.approx(sensing["noise"], rel=0.1)


def test_held_out_half_is_predicted(fits):
    for fit in fits:
        held = fit.held_out
        assert held["error"] == pytest.approx(held["predicted_error"], rel=0.15)
        assert held["error"] < 0.9 * held["uncorrected_error"]
        assert 0.9 < held["within_95"] < 0.97
        assert held["detection_brier"] < held["detection_brier_constant"]


def test_a_clean_log_has_little_that_the_model_does_not_express(fits):
    told = unexpressed(fits[0])
    assert len(told) == 1 and "Occlusion" in told[0]
    found = measures(fits[0])
    assert found["rows_of_landmarks"] == 0 and found["longest_gap"] < 0.31
    assert found["error_deviation_raw"] > 1.5 * found["error_deviation"]  # delay and bias


def test_rows_held_between_samples_count_once():
    ((bearings, poses),) = simulate(seeds=(2,), duration=120.0, every_step=True)
    log, frames = find_frames(from_tables(bearings, poses))
    assert frames.held and frames.regular
    assert frames.period == pytest.approx(KNOWN["sample_period"], rel=0.01)
    assert len(log.time) < 0.55 * len(bearings)


def test_listed_empty_frames_and_a_regular_clock_agree(logs):
    bearings, poses = logs[0]
    period = KNOWN["sample_period"]
    samples = [STEP * step for step in range(2, 5000) if is_sample(step - 2, period)]
    empty = [
        (time, robot, np.nan, np.nan)
        for robot in range(5)
        for time in np.setdiff1d(samples, bearings[bearings[:, 1] == robot, 0])
    ]
    inferred = find_frames(from_tables(bearings, poses))[1]
    listed = find_frames(from_tables(np.concatenate([bearings, empty]), poses))[1]
    assert listed.complete and inferred.complete
    assert len(listed.time) == pytest.approx(len(inferred.time), rel=0.01)
    assert len(listed.time) == 5 * len(samples)


@pytest.mark.slow
def test_an_all_round_sensor_with_dropout_has_no_other_effect():
    sensing = {"noise": 0.05, "dropout": 0.2}
    ((bearings, poses),) = simulate(sensing, seeds=(0,), duration=120.0, n_robots=3)
    fields = fit_sensor(from_tables(bearings, poses)).fields
    assert set(fields) <= {"noise", "dropout", "sample_period", "bias", "observer_bias"}
    assert fields["noise"] == pytest.approx(0.05, rel=0.05)
    assert fields["dropout"] == pytest.approx(0.2, abs=0.03)
    assert fields["sample_period"] == pytest.approx(0.1, rel=1e-3)
    assert fields.get("bias", 0.0) < 0.01


@pytest.mark.slow
def test_bearings_of_other_robots_are_told_from_uniform_outliers():
    sensing = {"noise": 0.01, "outliers": 0.1, "outlier_kind": "robot"}
    ((bearings, poses),) = simulate(sensing, seeds=(0,), duration=100.0, n_robots=4)
    fit = fit_sensor(from_tables(bearings, poses))
    assert fit.fields["outlier_kind"] == "robot"
    one = fit.parameters["outliers"]
    assert one.low < 0.1 < one.high < 0.12


@pytest.mark.slow
def test_delay_scan_finds_a_delay_of_both_signs():
    ((bearings, poses),) = simulate({"noise": 0.01}, seeds=(0,), duration=60.0, n_robots=3)
    for shift in (-0.13, 0.37):
        log = from_tables(bearings + np.array([shift, 0.0, 0.0, 0.0]), poses)
        best = scan_delay(log, Blocks(3, log.duration, 0.1, 0)).best
        assert best.value == pytest.approx(shift, abs=0.005)


def test_too_few_rows_are_an_error():
    ((bearings, poses),) = simulate({"noise": 0.01}, seeds=(0,), duration=1.0, n_robots=2)
    with pytest.raises(LogError, match="needs 50 or more"):
        fit_sensor(from_tables(bearings, poses))


def test_variance_components_of_a_balanced_table():
    """Means over many groups and pairs have the closed-form estimate."""
    random = np.random.default_rng(0)
    groups = np.repeat(np.arange(200), 4)
    y = 0.03 * random.normal(size=200)[groups] + 0.01 * random.normal(size=800)
    table = y.reshape(200, 4)
    within = table.var(axis=1, ddof=1).mean()
    between = (table.mean(axis=1) ** 2).mean() - within / 4
    pair, common = _components(y, np.full(800, 1e-12), groups)
    assert pair.value == pytest.approx(math.sqrt(within), rel=0.05)
    assert common.value == pytest.approx(math.sqrt(between), rel=0.05)
    assert pair.low < 0.01 < pair.high and common.low < 0.03 < common.high


def test_share_in_view_is_that_of_the_engine():
    """Linear from 1 at the inner border to 0 at the edge."""
    bearing = np.array([0.0, 0.39, 0.5, 0.7, 0.8, 0.9, -0.7])
    expected = [1.0, 1.0, 0.75, 0.25, 0.0, 0.0, 0.25]
    assert share_in_view(bearing, 0.8, 0.4) == pytest.approx(expected)
    assert share_in_view(bearing, 0.8, 0.0).tolist() == [1, 1, 1, 1, 1, 0, 1]


def test_weighted_quantile_repeats_values():
    values = np.array([1.0, 2.0, 3.0])
    assert weighted_quantile(values, np.array([1.0, 1.0, 8.0]), 0.5) == 3.0
    assert weighted_quantile(values, np.array([8.0, 1.0, 1.0]), 0.5) == 1.0
