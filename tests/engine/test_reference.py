"""Simulator compared with an independent integrator: DOP853, global positions, own merging."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from conftest import UNEQUAL, five, law_of
from scipy.integrate import solve_ivp

from rendezvous_env import rollout

POSITIONS = np.array(
    [[-3.0, 1.2, 0.4], [2.1, 3.4, -0.9], [3.6, -1.3, 0.8], [-0.7, -3.2, -1.1], [0.4, 0.9, 1.7]]
)
HEADINGS = np.array([[0.3, 0.2], [-2.1, -0.3], [1.4, 0.1], [2.9, 0.4], [-0.8, -0.2]])
GRAPHS = {"unequal": UNEQUAL, "complete": np.ones((5, 5)) - np.eye(5)}
RADIUS = 0.25


def velocities(p: np.ndarray, angles: np.ndarray, a: np.ndarray) -> np.ndarray:
    """ṗ and the angular rates, from the paper's formulas in the global frame."""
    n, d = p.shape
    f = np.zeros((n, d))
    for i in range(n):
        for j in range(n):
            if a[i, j] > 0:
                f[i] += a[i, j] * (p[j] - p[i]) / math.dist(p[i], p[j])
    if angles.shape[1] == 0:
        return np.hstack([f, angles])
    yaw = angles[:, 0]
    if angles.shape[1] == 1:  # (5), (7), (8)
        h = np.stack([np.cos(yaw), np.sin(yaw)], axis=1)
        across = np.stack([-np.sin(yaw), np.cos(yaw)], axis=1)
        v, omega = (h * f).sum(axis=1), (across * f).sum(axis=1)
        return np.hstack([v[:, None] * h, omega[:, None]])
    # (9)–(17): ṗ = h hᵀf, and ḣ = A (α̇, β̇) is the least-squares answer to P_h f
    rates = np.empty((n, 5))
    for i, (alpha, beta) in enumerate(angles):
        ca, sa, cb, sb = math.cos(alpha), math.sin(alpha), math.cos(beta), math.sin(beta)
        h = np.array([cb * ca, cb * sa, sb])
        jacobian = np.array([[-cb * sa, -sb * ca], [cb * ca, -sb * sa], [0.0, cb]])
        wanted = f[i] - h * (h @ f[i])
        rates[i, :3] = h * (h @ f[i])
        rates[i, 3:] = np.linalg.lstsq(jacobian, wanted, rcond=None)[0]
    return rates


def contracted(p, angles, a, i, j):
    """Merge robots i < j: i at the midpoint with the union of the links; j is deleted."""
    p, a = p.copy(), a.copy()
    p[i] = (p[i] + p[j]) / 2
    a[i] = a[:, i] = np.maximum(a[i], a[j])
    a[i, i] = 0
    keep = np.arange(len(p)) != j
    return p[keep], angles[keep], a[np.ix_(keep, keep)]


def integrate(p: np.ndarray, angles: np.ndarray, a: np.ndarray) -> SimpleNamespace:
    """Integrate to rendezvous, stopping at every merge.

    Returns the times of the first merge and of rendezvous, s. For the time before that merge, it
    also returns positions as functions of time, (n, d), m, and the largest pitch, rad.
    """
    d, n_angles, now, first = p.shape[1], angles.shape[1], 0.0, None
    while len(p) > 1:
        n = len(p)

        def unpack(y, n=n):
            table = y.reshape(n, d + n_angles)
            return table[:, :d], table[:, d:]

        links = [(i, j) for i in range(n) for j in range(i + 1, n) if a[i, j] > 0]

        def gap(t, y, i, j):
            q, _ = unpack(y)
            return math.dist(q[i], q[j]) - RADIUS

        events = [lambda t, y, i=i, j=j: gap(t, y, i, j) for i, j in links]
        for event in events:
            event.terminal, event.direction = True, -1
        solution = solve_ivp(
            lambda t, y, a=a: velocities(*unpack(y), a).ravel(),
            (now, now + 200.0),
            np.hstack([p, angles]).ravel(),
            method="DOP853",
            events=events,
            rtol=1e-10,
            atol=1e-10,
            dense_output=first is None,
        )
        assert solution.status == 1, "nobody merged"
        (which,) = (k for k, times in enumerate(solution.t_events) if len(times))
        now = float(solution.t[-1])
        if first is None:
            _, attitudes = unpack(solution.y.T.ravel(), solution.y.shape[1] * n)
            pitch = np.abs(attitudes[:, 1:]).max(initial=0.0)
            before = lambda t, u=unpack, y=solution.sol: u(y(t))[0]  # noqa: E731
            first = {"first_merge": now, "positions": before, "largest_pitch": pitch}
        p, angles, a = contracted(*unpack(solution.y[:, -1]), a, *links[which])
        while close := [
            (math.dist(p[i], p[j]), i, j)
            for i in range(len(p))
            for j in range(i + 1, len(p))
            if a[i, j] > 0 and math.dist(p[i], p[j]) < RADIUS
        ]:
            p, angles, a = contracted(p, angles, a, *min(close)[1:])
    return SimpleNamespace(**first, rendezvous=now)


@pytest.mark.parametrize("graph", GRAPHS)
def test_simulator_converges_to_ode_reference(kind, graph):
    scenario = five(kind, graph=GRAPHS[graph], merge_radius=RADIUS, time_limit=200.0)
    flatter = 0.2 if scenario.model.nonholonomic else 1.0  # near a pitch of ±π/2 their law is stiff
    places = (POSITIONS * [1.0, 1.0, flatter])[:, : scenario.dim]
    angles = HEADINGS[:, : scenario.model.n_angles]
    headed = {"headings": angles} if scenario.model.nonholonomic else {}
    expected = integrate(places, angles, GRAPHS[graph])
    assert expected.first_merge > 0.5 and expected.largest_pitch < 0.8
    errors, steps = {}, math.floor(0.95 * expected.first_merge / 2e-3)
    for tau, k in ((2e-3, steps), (1e-3, 2 * steps)):
        fine = scenario.replace(time_step=tau)
        found = rollout(fine, law_of(fine), options={"positions": places, **headed})
        assert found.active[k].all() and found.success.all()
        away = found.positions[k, 0] - expected.positions(found.times[k])
        errors[tau] = np.linalg.norm(away, axis=-1).max()
    tolerance, late = (5e-3, 0.03) if scenario.model.nonholonomic else (1e-3, 0.01)
    assert errors[1e-3] < tolerance
    assert errors[2e-3] / errors[1e-3] == pytest.approx(2, rel=0.1)
    assert found.rendezvous_time == pytest.approx(expected.rendezvous, rel=late)


def test_reference_matches_closed_form():
    """Two robots, gain a: they meet after (L − r)/(2a)."""
    pair = np.array([[0.0, 0.0], [3.0, 4.0]])
    solved = integrate(pair, np.zeros((2, 0)), np.array([[0, 0.8], [0.8, 0]]))
    assert solved.rendezvous == pytest.approx((5 - RADIUS) / 1.6, abs=1e-8)
    np.testing.assert_allclose(solved.positions(1.0), [[0.48, 0.64], [2.52, 3.36]], atol=1e-8)
