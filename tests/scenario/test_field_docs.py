"""``help`` of scenarios, certificates and their parts: complete lists of fields."""

import dataclasses
import inspect
import pydoc
from functools import partial
from typing import Annotated, Literal

import numpy as np
import pytest

import rendezvous_env as rv
from rendezvous_env import baselines, checks
from rendezvous_env.field_docs import bounds_of, described_fields, lists_fields

LISTED = (
    *(rv.Scenario, rv.Certificate, rv.Sensing, rv.RewardWeights, rv.ObstacleField, rv.WallField),
    *(rv.Trajectory, rv.ObservationLayout),
)


@pytest.mark.parametrize("cls", LISTED)
def test_help_shows_every_field_with_its_meaning(cls):
    shown = " ".join(pydoc.plaintext.document(cls).split())
    for field, (name, _, meaning, _) in zip(
        dataclasses.fields(cls), described_fields(cls), strict=True
    ):
        assert name == field.name
        assert len(meaning) > 10, name
        for word in meaning.split():
            assert word in shown, (name, word)


def test_help_shows_defaults_and_bounds():
    text = inspect.getdoc(rv.Scenario)
    flat = " ".join(text.split())
    assert "    n_robots = 5\n" in text
    assert "integer from 2 to 10000" in text
    assert "    merge_radius = 0.2\n" in text
    assert "number from 1e-09 to 1e+09 m/s²" in text
    assert "one of 'slide', 'stop', 'ignore'" in flat
    assert "    sensing = Sensing()\n" in text
    assert "    lyapunov_bound = inf\n" in inspect.getdoc(rv.Certificate)


@pytest.mark.parametrize(
    ("hint", "words"),
    [
        (Annotated[int, partial(checks.check_int, least=2, most=9)], "an integer from 2 to 9"),
        (
            Annotated[float, partial(checks.positive, unit="s")] | None,
            "None, or a number from 1e-09",
        ),
        (Literal["a", "b"], "one of 'a', 'b'"),
        (Annotated[float, partial(checks.number, least=0.0, most=1.0)], "a number from 0 to 1"),
        (Annotated[bool, checks.flag], "True or False"),
        (int, ""),
        (Annotated[int, lambda field, value: value], ""),
    ],
)
def test_bounds_are_those_of_the_annotation(hint, words):
    assert bounds_of(hint).startswith(words)
    assert bool(words) == bool(bounds_of(hint))


def test_bounds_of_scenarios_are_those_that_are_checked():
    with pytest.raises(ValueError, match="at most 10000"):
        rv.Scenario(n_robots=10_001)
    listed = {name: bounds for name, _, _, bounds in described_fields(rv.Scenario)}
    assert listed["n_robots"] == "an integer from 2 to 10000"


def test_fields_are_listed_without_source(monkeypatch):
    @lists_fields
    @dataclasses.dataclass
    class Typed:
        """Typed in."""

        size: int = 3

    monkeypatch.setattr(inspect, "getsource", lambda cls: (_ for _ in ()).throw(OSError()))
    assert inspect.getdoc(Typed) == "Typed in.\n\nFields:\n    size = 3"


def test_a_subclass_lists_its_own_fields():
    @lists_fields
    @dataclasses.dataclass
    class First:
        """One."""

        size: int = 3
        """How large."""

    class Second(First):
        pass

    assert "How large." in First.__doc__
    assert Second.__doc__ is None or "size" in Second.__doc__


def test_obstacle_field_needs_a_number_only():
    scenario = rv.Scenario(obstacles=rv.ObstacleField(4), n_robots=4)
    simulator = rv.Simulator(scenario, 20)
    simulator.reset(0)
    assert np.isfinite(simulator.positions).all()
    assert scenario.replace(obstacles={"count": 4}).obstacles == rv.ObstacleField(4)
    again = rv.Scenario.from_plain(scenario.to_plain())
    assert again == scenario


def test_a_constant_compass_error_cancels_for_laws_without_memory():
    """The error rotates the frame of measurements and actions, which may be given initially."""
    scenario = rv.Scenario(n_robots=4)
    turned = np.random.default_rng(0).uniform(-np.pi, np.pi, 4)
    cos, sin = np.cos(turned), np.sin(turned)
    frames = np.stack([np.stack([cos, -sin], -1), np.stack([sin, cos], -1)], axis=-2)
    law = baselines.make("bearing-only", scenario)
    straight = rv.rollout(scenario, law, options={"frames": np.tile(np.eye(2), (4, 1, 1))})
    skewed = rv.rollout(scenario, law, options={"frames": frames})
    np.testing.assert_allclose(straight.positions, skewed.positions, atol=1e-5)
