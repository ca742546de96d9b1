"""What ``rendezvous bench`` times of sensors that err, beside the exact one."""

from __future__ import annotations

import rendezvous_env as rv

from .bench_cases import Case, dicts_of, simulator_of, spread_out

SENSORS = {
    "noise": rv.Sensing(noise=0.1),
    "noise, dropout, range": rv.Sensing(noise=0.1, dropout=0.1, range=1e6),
}


def sensing(n: int, num_envs: int, num_threads: int | None) -> list[list[Case]]:
    """Steps of one team in dicts and of many teams: two groups of cases."""
    sensors = {"exact sensor": rv.Sensing()} | SENSORS
    one, many = [], []
    for name, sensor in sensors.items():
        scenario = spread_out(n, sensing=sensor)
        against = "exact sensor" if name in SENSORS else ""
        one.append(
            Case(name, "sensing", n, 1, 1, "team steps", lambda s=scenario: dicts_of(s), against)
        )
        many.append(
            Case(
                name,
                "sensing",
                n,
                num_envs,
                num_envs,
                "team steps",
                lambda s=scenario: simulator_of(s, num_envs, num_threads),
                against,
            )
        )
    return [one, many]
