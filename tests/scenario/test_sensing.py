"""The sensor as part of a scenario: fields, refusals, files."""

from __future__ import annotations

import dataclasses
import json
import math

import pytest

import rendezvous_env as rv

WRONG = {
    "range": (0.0, -1.0, math.nan, math.inf, "far", True, 1e12),
    "field_of_view": (0.0, -1.0, 6.3, math.nan, math.inf, None, "wide"),
    "noise": (-0.1, math.nan, math.inf, 7.0, None, "much", False),
    "bias": (-1e-9, math.nan, math.inf, 7.0),
    "error": (-0.1, 3.2, math.nan, math.inf, "left"),
    "dropout": (-0.1, 1.1, math.nan, math.inf, None),
    "delay": (-1, 1.5, 10_001, math.nan, None, True, 10**400),
    "sectors": (1, 0, -4, 2.5, 10**7, math.inf, "many"),
    "occlusion": ("all", "", None, True, ["both"]),
}
UNLIKE = {
    "range": 3.0, "field_of_view": 2.0, "noise": 0.1, "bias": 0.2, "error": 0.3,
    "dropout": 0.25, "delay": 4, "sectors": 12, "occlusion": "both",
}  # fmt: skip


def test_the_fields_and_defaults_of_the_design():
    fields = {field.name: field.default for field in dataclasses.fields(rv.Sensing)}
    assert fields == {
        "range": None, "field_of_view": 2 * math.pi, "noise": 0.0, "bias": 0.0, "error": 0.0,
        "dropout": 0.0, "delay": 0, "sectors": None, "occlusion": "none", "custom": (),
    }  # fmt: skip
    assert rv.Sensing().exact and rv.Scenario().sensing == rv.Sensing()


def test_the_camera_is_a_sensor_like_any_other():
    """Its numbers are those of docs/worlds.md, and what is hidden has no row."""
    camera = rv.Sensing.camera()
    assert camera.occlusion == "both" and not camera.exact
    assert math.degrees(camera.noise) == pytest.approx(0.43, abs=0.01)
    assert rv.Sensing(**camera.to_plain()) == camera == rv.Sensing.camera()
    discs = (rv.Disc((0.0, 0.0), 0.5), rv.Capsule(((90.0, 0.0), (91.0, 0.0)), 0.5))
    places = ((-2.0, 0.0), (2.0, 0.0), (0.0, 3.0))
    scenario = rv.Scenario(n_robots=3, start_positions=places, obstacles=discs, sensing=camera)
    seen = rv.Simulator(scenario, 100).reset(0)
    shares = scenario.observation_layout.split(seen).neighbours.any(-1).mean(0).sum(-1)
    assert shares[:2] == pytest.approx(1.0, abs=0.1) and shares[2] == pytest.approx(2.0, abs=0.2)
    assert not rv.certificate(scenario).guaranteed


@pytest.mark.parametrize("field", UNLIKE)
def test_each_field_makes_another_sensor(field):
    one = rv.Sensing(**{field: UNLIKE[field]})
    assert not one.exact and one != rv.Sensing()
    again = rv.Sensing(**{field: UNLIKE[field]})
    assert one == again and hash(one) == hash(again)
    assert one.departures() == f"{field} = {UNLIKE[field]}"
    assert rv.Scenario(sensing=one) != rv.Scenario()
    with pytest.raises(dataclasses.FrozenInstanceError):
        setattr(one, field, UNLIKE[field])


@pytest.mark.parametrize(("field", "value"), [(f, v) for f, vs in WRONG.items() for v in vs])
def test_a_wrong_value_is_refused_by_field_and_value(field, value):
    with pytest.raises(ValueError, match=rf"^sensing\.{field} is .*; it must be ") as refused:
        rv.Sensing(**{field: value})
    shown = "whole number of about" if value == 10**400 else repr(value)
    assert shown in str(refused.value)


def test_an_unknown_field_is_refused_with_the_nearest():
    with pytest.raises(ValueError, match="did you mean 'dropout'"):
        rv.Sensing(drop_out=0.1)
    with pytest.raises(ValueError, match=r"sensing has no field 'nois'.*'noise'"):
        rv.Scenario.from_plain({"sensing": {"nois": 0.1}})
    with pytest.raises(ValueError, match="sensing has no field 5; known are range, "):
        rv.Scenario(sensing={5: 0.1})
    with pytest.raises(ValueError, match="sensing is 'exact'; it must be a Sensing"):
        rv.Scenario(sensing="exact")


@pytest.mark.parametrize("field", [*UNLIKE, None])
def test_a_scenario_with_a_sensor_survives_a_file_and_json(field, tmp_path):
    given = UNLIKE if field is None else {field: UNLIKE[field]}
    scenario = rv.Scenario(name="erring", sensing=rv.Sensing(**given))
    scenario.to_toml(tmp_path / "erring.toml")
    assert rv.Scenario.from_toml(tmp_path / "erring.toml") == scenario
    assert "[sensing]" in (tmp_path / "erring.toml").read_text(encoding="utf-8")
    assert rv.Scenario.from_plain(json.loads(json.dumps(scenario.to_plain()))) == scenario


def test_an_exact_sensor_is_an_absent_table(tmp_path):
    assert "sensing" not in rv.Scenario().to_plain()
    text = 'graph = "complete"\n[sensing]\nrange = 4\ndelay = 2\n'
    (tmp_path / "short.toml").write_text(text, encoding="utf-8")
    read = rv.Scenario.from_toml(tmp_path / "short.toml").sensing
    assert read == rv.Sensing(range=4.0, delay=2) and isinstance(read.range, float)
