"""Environments that nobody has written golden functions for, to be followed by ``pearl new --from``."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from gymnasium.spaces import Box, Dict, Discrete, MultiBinary, MultiDiscrete


class Corridor(gymnasium.Env[Any, Any]):
    """Finite, without a table: a walk to the right on slippery ground, with a wind that turns."""

    observation_space = Box(-1, 6, (2,), np.int64)
    action_space = Discrete(3)

    def __init__(self, length: int = 6) -> None:
        self.length = length
        self.unused = np.zeros(3)

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[Any, Any]:
        super().reset(seed=seed)
        self.cell = int(self.np_random.integers(1, 4))
        self.wind = int(self.np_random.choice([-1, 1], p=[0.25, 0.75]))
        return self._seen(), {}

    def _seen(self) -> Any:
        return np.array([self.wind, self.cell])

    def step(self, action: Any) -> tuple[Any, float, bool, bool, Any]:
        if self.np_random.integers(5) == 0:
            self.wind = -self.wind
        self.cell = min(max(self.cell + int(action) - 1, 0), self.length)
        if action == 1:
            self.cell = min(max(self.cell + self.wind, 0), self.length)
        ended = self.cell in (0, self.length)
        return self._seen(), 2.5 * (self.cell == self.length) - (self.cell == 0) - 0.25, ended, False, {}


class Endless(gymnasium.Env[Any, Any]):
    """As many states as steps."""

    observation_space = Discrete(2)
    action_space = Discrete(2)

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[Any, Any]:
        super().reset(seed=seed)
        self.total = 0
        return 0, {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, Any]:
        self.total += 1 + int(action)
        return self.total % 2, 1.0, self.total > 1000, False, {}


class Garden(gymnasium.Env[Any, Any]):
    """Beds in an array, a gardener in an object, and rain; the sun is a real number."""

    observation_space = Box(0, 9, (4,), np.uint8)
    action_space = Discrete(3)

    class Gardener:
        """Where somebody is."""

        bed = 0

    def __init__(self, rain: float = 0.25) -> None:
        self.rain, self.gardener, self.beds = rain, self.Gardener(), np.zeros(3, np.int8)
        self.weather = "dry"

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[Any, Any]:
        super().reset(seed=seed)
        self.gardener.bed = int(self.np_random.integers(3))
        self.beds = np.zeros(3, np.int8)
        return self._seen(), {}

    def _seen(self) -> Any:
        return np.array([*self.beds, self.gardener.bed], np.uint8)

    def step(self, action: Any) -> tuple[Any, float, bool, bool, Any]:
        rains = self.np_random.random() < self.rain
        self.weather = "wet" if rains else "dry"
        if rains:
            self.beds += 1
        if action == 2:
            self.beds[self.gardener.bed] = 0
        else:
            self.gardener.bed = (self.gardener.bed + int(action) + 1) % 3
        wild = bool(self.beds.max() >= 9)
        return self._seen(), -5.0 if wild else float(action == 2), wild, False, {}


class Named(Corridor):
    """Cannot be made without an argument."""

    def __init__(self, title: str) -> None:
        super().__init__()


class Dicts(Corridor):
    observation_space = Dict({"cell": Discrete(7)})  # type: ignore[assignment]


class Many(Corridor):
    action_space = MultiDiscrete([2, 2], start=[1, 1])  # type: ignore[assignment]


class Broken(Corridor):
    def __init__(self) -> None:
        raise RuntimeError("no display")


class Lamps(gymnasium.Env[Any, Any]):
    """An action of two fields, a lamp and what becomes of it; and an observation of bits."""

    observation_space = MultiBinary(4)
    action_space = MultiDiscrete([4, 2])

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[Any, Any]:
        super().reset(seed=seed)
        self.lit = self.np_random.integers(0, 2, 4, np.int8)
        return self.lit.copy(), {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, Any]:
        lamp, lights = action
        self.lit[lamp] = lights
        return self.lit.copy(), -1.0, bool(self.lit.all()), False, {}


class Meeting:
    """Two agents in PettingZoo's parallel form, who step towards each other or stay."""

    possible_agents = ("left", "right")
    metadata: dict[str, Any] = {}  # noqa: RUF012

    def observation_space(self, agent: str) -> Discrete:
        return Discrete(10)

    def action_space(self, agent: str) -> Discrete:
        return Discrete(2)

    def reset(self, seed: int | None = None, options: Any = None) -> tuple[Any, Any]:
        self.agents, self.places = list(self.possible_agents), [0, 9]
        return self._seen(), {}

    def _seen(self) -> dict[str, int]:
        return dict(zip(self.possible_agents, self.places, strict=True))

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, Any]:
        left, right = self.places
        self.places = [left + int(actions["left"]), right - int(actions["right"])]
        met = self.places[0] >= self.places[1]
        ends = dict.fromkeys(self.possible_agents, met)
        rewards = {agent: 1.0 if met else -0.5 * actions[agent] for agent in self.possible_agents}
        self.places = [min(self.places[0], 9), max(self.places[1], 0)]
        if met:
            self.agents = []
        return self._seen(), rewards, ends, dict.fromkeys(self.possible_agents, False), {}


class Ball(gymnasium.Env[Any, Any]):
    """Real numbers: something that is pushed, and slows down."""

    observation_space = Box(-50, 50, (2,), np.float32)
    action_space = Discrete(3)

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[Any, Any]:
        super().reset(seed=seed)
        self.place, self.speed = float(self.np_random.uniform(-1, 1)), 0.0
        return self._seen(), {}

    def _seen(self) -> Any:
        return np.array([self.place, self.speed], np.float32)

    def step(self, action: Any) -> tuple[Any, float, bool, bool, Any]:
        self.speed = 0.9 * self.speed + 0.1 * (int(action) - 1)
        self.place += self.speed
        return self._seen(), -1.0, abs(self.place) > 4, False, {}
