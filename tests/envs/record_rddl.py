"""Records steps of the elevators of ``rddlrepository``, for ``test_elevators.py`` to repeat.

    python -m venv oracle && oracle/bin/pip install pyRDDLGym==2.7 rddlrepository==2.2
    oracle/bin/python tests/envs/record_rddl.py tests/envs/rddl.npz

Of each of the ten instances there are as many steps, from states that follow from a seed, and so do actions
and arrivals. Of each step a checksum is recorded of all fluents after it, and the reward in quarters. Besides
them, there are each instance's chances of arrivals by the floor, and the fluents that it begins with.
"""

from __future__ import annotations

import sys
import zlib
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

INSTANCES, STEPS, HORIZON = range(1, 11), 10_400, 40


class Inputs(NamedTuple):
    """Of each step, whatever it follows from."""

    waiting: Any
    """Whether passengers wait on each floor between, for up and for down: ``(steps, 2, floors)``."""
    floors: Any
    """Where the cars are, ``(steps, cars)``."""
    flags: Any
    """Of each car whether it goes up, is closed, and has passengers for up and down: ``(steps, cars, 4)``."""
    actions: Any
    """Of each car: nothing, move, open upwards, open downwards, close."""
    arrivals: Any
    """As ``waiting``."""


def inputs(instance: int, floors: int, cars: int) -> Inputs:
    """Return the inputs of an instance's steps, of NumPy's old generator, whose numbers stay the same."""
    generator = np.random.RandomState(instance)

    def flags(*shape: int) -> Any:
        return generator.randint(0, 2, (STEPS, *shape))

    places = generator.randint(0, floors, (STEPS, cars))
    actions = generator.randint(0, 5, (STEPS, cars))
    return Inputs(flags(2, floors - 2), places, flags(cars, 4), actions, flags(2, floors - 2))


def checksum(fluents: Any, quarters: Any) -> int:
    """Return eight bits of all that is said of a step."""
    return zlib.crc32(np.int8(fluents).tobytes() + np.int8(quarters).tobytes()) & 255


class Arrivals:
    """Draws by which given passengers arrive, in place of the simulator's generator and list of equations."""

    def __init__(self, equations: list[Any]) -> None:
        self.equations, self.arrive, self._name = equations, np.zeros((2, 0)), ""

    def __iter__(self) -> Iterator[Any]:
        for equation in self.equations:
            self._name = equation[0]
            yield equation

    def uniform(self, size: Any) -> Any:
        """Return a draw for each floor: one without an arrival is above every chance."""
        between = self.arrive[("down" in self._name) * 1]
        return np.where(np.concatenate([[0], between, [0]]), 0.0, 1.0).reshape(size)


def main() -> None:
    import pyRDDLGym

    recorded: dict[str, Any] = {}
    for instance in INSTANCES:
        env = pyRDDLGym.make("Elevators_MDP_ippc2011", str(instance))
        game = env.sampler
        begun, _ = env.reset()
        assert env.horizon == HORIZON
        chances = np.array(game.subs["ARRIVE-PARAM"])
        cars, floors = game.subs["elevator-at-floor"].shape
        game.rng = game.cpfs = draws = Arrivals(game.cpfs)
        checks = np.zeros(STEPS, np.uint8)
        for step, (waiting, places, flags, actions, draws.arrive) in enumerate(
            zip(*inputs(instance, floors, cars), strict=True)
        ):
            up, down = np.pad(waiting, ((0, 0), (1, 1))).astype(bool)
            of_cars = ("dir-up", "closed"), ("going-up", "going-down")
            names = [f"elevator-{name}" for name in of_cars[0]]
            names += [f"person-in-elevator-{name}" for name in of_cars[1]]
            game.subs.update(zip(names, flags.astype(bool).T, strict=True))
            game.subs |= {"person-waiting-up": up, "person-waiting-down": down}
            game.subs["elevator-at-floor"] = np.arange(floors) == places[:, None]
            kinds = "move-current-dir", "open-door-going-up", "open-door-going-down", "close-door"
            taken = {f"{kinds[action - 1]}___e{car}": True for car, action in enumerate(actions) if action}
            prepared = game.prepare_actions_for_sim(taken)
            game.check_default_action_count(prepared)
            game.check_action_preconditions(prepared)
            after, reward, over = game.step(prepared)
            assert not over
            checks[step] = checksum(list(after.values()), 4 * reward)
        recorded |= {f"{instance}/chances": chances, f"{instance}/start": np.int8(list(begun.values()))}
        recorded |= {f"{instance}/checks": checks, f"{instance}/cars": cars}
    np.savez_compressed(sys.argv[1], **recorded)
    print(f"{len(INSTANCES) * STEPS:,} steps")


if __name__ == "__main__":
    main()
