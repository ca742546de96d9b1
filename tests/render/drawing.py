"""Helpers for images: a rendered environment, and colours of pixels."""

import os

os.environ.setdefault("SDL_VIDEODRIVER", "dummy")
os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")

import numpy as np

import rendezvous_env as rv


def still(env):
    """Zero actions."""
    return {name: np.zeros(env.action_space(name).shape, np.float32) for name in env.agents}


def drawn(scenario="fig4", steps=0, *, options=None, mode="rgb_array", **overrides):
    """An environment after some steps at rest, and its image."""
    env = rv.parallel_env(scenario, render_mode=mode, **overrides)
    env.reset(seed=0, options=options)
    for _ in range(steps):
        env.step(still(env))
    return env, env.render()


def at(frame, place):
    """Colour of the pixel nearest to a position (x, y)."""
    x, y = np.round(place).astype(int)
    return frame[y, x].tolist()


def near(frame, place, colour, reach):
    """Number of pixels near a position with approximately a colour."""
    x, y = np.round(place).astype(int)
    part = frame[max(0, y - reach) : y + reach + 1, max(0, x - reach) : x + reach + 1].astype(int)
    return int((np.abs(part - colour).max(axis=-1) < 30).sum())
