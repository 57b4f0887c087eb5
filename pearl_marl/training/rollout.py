"""Gathering experience: agents act by a policy that stays as it is, for some steps of each.

What is gathered depends on the weights, the state of the agents and the number of the rollout, and on
nothing else. Whoever gathers, and with whomever the agents are shared, gathers the same.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from pearl_marl.batch.config import worlds_of
from pearl_marl.batch.saved_state import SavedState
from pearl_marl.devices import BatchConfig, BatchStep, Cuda, Device, make_device
from pearl_marl.errors import ArgumentError
from pearl_marl.packing import packed
from pearl_marl.policies.network import MASKED, check_weights, masked
from pearl_marl.spec import EnvSpec
from pearl_marl.training.actor_critic import ActorCritic, View
from pearl_marl.training.advantages import Course, advantages
from pearl_marl.training.restoring import copied, saved_bytes, whole
from pearl_marl.training.threads import threads_for

ROWS = 16_384
"""Observations that the critic is given at a time, for the memory that its layers take."""


def seen_spec(spec: EnvSpec, device: str | Device) -> EnvSpec:
    """Return the spec by which agents observe: on the host, of planes the words that make them."""
    on_gpu = device == Cuda.name or isinstance(device, Cuda)
    return spec if spec.unpack is None or on_gpu else packed(spec)


class Agents:
    """``n`` agents of whole worlds, the first of the global number ``first``; ``view`` is what they see now.

    They are stepped by tensors. Where the device has its results, these stay: of ``"cuda"`` on the GPU.
    With ``central``, the view has the states of their worlds.
    """

    view: View
    alive: Tensor  # who takes part in the next step
    acting: Tensor  # and has something to decide in it: not who waits for its turn

    def __init__(
        self,
        spec: EnvSpec,
        device: str | Device,
        n: int,
        seed: int,
        first: int = 0,
        central: bool = False,
    ) -> None:
        self.spec, self.central = spec, central
        self.device = make_device(device, tensors=True)
        first_slot = first // spec.agents
        kept = seen_spec(spec, device)
        self.device.open(BatchConfig(spec=kept, n_envs=worlds_of(spec, n), first_slot=first_slot))
        obs = torch.as_tensor(self.device.reset(seed))
        number = torch.arange(n, device=obs.device)
        self.position = number % spec.agents if spec.agents > 1 else None
        self.alive = number >= 0
        self._look(obs)

    @property
    def obs(self) -> Tensor:
        """What they observe now."""
        return self.view.obs

    def step(self, actions: Tensor) -> Any:
        """Step every agent; return a :class:`BatchStep` of tensors."""
        given: Any = actions if self.device.tensors else actions.numpy()
        step: Any = BatchStep(*map(torch.as_tensor, self.device.step(given)))  # type: ignore[arg-type]
        self._look(step.obs)
        return step

    def _look(self, obs: Any) -> None:
        obs = torch.as_tensor(obs)
        masks = state = None
        if self.device.action_masks is not None:
            masks = torch.as_tensor(self.device.action_masks, device=obs.device)
        if self.central:
            words = torch.as_tensor(self.device.state().astype(np.float32), device=obs.device)
            state = words.repeat_interleave(self.spec.agents, 0)
        self.view = View(obs, masks, self.position, state)
        if self.spec.agents > 1:  # who is alone in its world does not end before it
            self.alive = torch.as_tensor(self.device.alive, device=obs.device)
        self.acting = self.alive if masks is None else self.alive & (masks != 0).any(1)

    @property
    def config(self) -> BatchConfig:
        """What a saved state of these agents has to agree with."""
        return self.device.config

    def state(self) -> SavedState:
        """Return all that the agents' continuation depends on."""
        return self.device.snapshot()

    def load(self, state: SavedState) -> None:
        """Go on from what :meth:`state` returned."""
        self._look(self.device.restore(state))


TEAM = ("own", "mean", "sum")
"""Whose rewards an agent wants: see :func:`team_rewards`."""


def team_rewards(rewards: Tensor, agents: int, whose: str) -> Tensor:
    """Return, for each agent of a world, its own reward, or the mean or the sum of all of them."""
    if whose == "own" or agents == 1:
        return rewards
    worlds = rewards.reshape(*rewards.shape[:-1], -1, agents)
    together = worlds.mean(-1) if whose == "mean" else worlds.sum(-1)
    return together.repeat_interleave(agents, -1)


class Returns:
    """Mean return and length of the episodes that ``n`` agents finish, added up where the rewards are."""

    def __init__(self, n: int, where: torch.device) -> None:
        # Of the episodes under way: returns, lengths. Of those finished: number, returns, lengths.
        self._under_way = torch.zeros(2, n, dtype=torch.float64, device=where)
        self._finished = torch.zeros(3, dtype=torch.float64, device=where)

    def add(self, rewards: Tensor, ended: Tensor) -> None:
        """Count some steps of every agent, shape ``(steps, n)``."""
        steps = len(rewards)
        number = torch.arange(1, steps + 1, device=rewards.device)[:, None]
        # An agent's finished episodes together are all that it had up to the last step that ended one.
        last = (ended * number).amax(0, keepdim=True)
        so_far = torch.zeros(2, steps + 1, rewards.shape[1], dtype=torch.float64, device=rewards.device)
        so_far[0, 1:] = rewards
        so_far[1, 1:] = 1
        so_far[:, 0] = self._under_way
        so_far = so_far.cumsum(1)
        until_last = so_far.gather(1, last.expand(2, 1, -1))[:, 0] * (last > 0)
        self._under_way = so_far[:, -1] - until_last
        self._finished[0] += ended.sum()
        self._finished[1:] += until_last.sum(1)

    def take(self) -> dict[str, float | None]:
        """Return means, and the number of episodes, by the names of metrics; and begin anew."""
        episodes, returns, lengths = self._finished.tolist()
        self._finished.zero_()
        return {
            "train_return": returns / episodes if episodes else None,
            "train_length": lengths / episodes if episodes else None,
            "episodes": int(episodes),
        }

    def state(self) -> tuple[Tensor, Tensor]:
        """Return all that the continuation depends on."""
        return self._under_way, self._finished

    def load(self, state: tuple[Tensor, Tensor]) -> None:
        """Go on from what :meth:`state` returned."""
        for mine, kept in zip(self.state(), state, strict=True):
            copied("sums of episodes", mine, kept)


class Trainer:
    """A run of any algorithm: ``iterate`` goes on by one iteration, and ``policy`` is what has been learned.

    Parameters
    ----------
    settings
        The run's.
    agents
        Who gathers: :class:`Agents`, or what else has ``state``, ``load`` and ``config``.
    where
        The device of torch that has their observations, and on which is learned.
    """

    policy: Any

    def __init__(self, settings: Any, agents: Any, where: torch.device) -> None:
        self.settings, self.agents, self.where = settings, agents, where
        self.random = torch.Generator(where).manual_seed(settings.seed)
        self.episodes = Returns(settings.n_agents, where)
        self.learned: dict[str, Any] = {}  # modules and optimisers, by their names in a checkpoint
        self.done = 0  # iterations so far
        self.depth = 1  # steps of every agent in an iteration
        self.evaluated = 256  # agents whose first episodes are an evaluation, unless said otherwise

    @property
    def agent_steps(self) -> int:
        """Steps of single agents so far."""
        return int(self.done * self.depth * self.settings.n_agents)

    def iterate(self) -> None:
        """Go on by one iteration, with as many threads of PyTorch as help."""
        with threads_for(self.policy.spec, self.settings):
            self.update()

    def update(self) -> None:
        """Do what an iteration of the algorithm is."""
        raise NotImplementedError

    def check(self, losses: Tensor) -> None:
        """Refuse to go on from losses that are no numbers: what the policy does is none either, then."""
        if not torch.isfinite(losses).all():
            raise ArgumentError(
                f"the training has diverged, as the loss of iteration {self.done + 1:,} is no number: make "
                "the setting 'learning_rate' smaller, or bring rewards nearer to 1 with 'reward_scale'"
            )

    def figures(self) -> dict[str, float | None]:
        """Return figures for the metrics, of episodes since they were last asked for."""
        return self.episodes.take()

    def explore(self, best: Tensor, n_actions: int, share: float, masks: Tensor | None = None) -> Tensor:
        """Return the best actions, of which a share is replaced by random ones that the masks allow."""
        random = torch.rand(len(best), generator=self.random, device=self.where) < share
        if masks is None:
            anything = torch.randint(n_actions, best.shape, generator=self.random, device=self.where)
        else:
            chances = torch.rand(masks.shape, generator=self.random, device=self.where)
            anything = masked(chances, masks).argmax(1)
        return torch.where(random, anything, best)

    def state(self) -> dict[str, Any]:
        """Return all that the continuation depends on: tensors and plain data."""
        agents = torch.frombuffer(bytearray(self.agents.state().to_bytes()), dtype=torch.uint8)
        return {
            "done": self.done,
            "random": self.random.get_state(),
            "agents": agents,
            "episodes": self.episodes.state(),
            **{name: part.state_dict() for name, part in self.learned.items()},
        }

    def load(self, state: dict[str, Any]) -> None:
        """Go on from what :meth:`state` returned."""
        self.done = whole("number of iterations", state["done"])
        for name, part in self.learned.items():
            if isinstance(part, torch.nn.Module):
                check_weights(part, state[name], f"{self.policy.spec.name}'s {name}")
            part.load_state_dict(state[name])
        self.random.set_state(state["random"])
        agents = saved_bytes("state of agents", state["agents"])
        self.agents.load(SavedState.from_bytes(agents, self.agents.config))
        self.episodes.load(state["episodes"])


class Experience(NamedTuple):
    """A rollout, a row a step and a column an agent."""

    view: View
    actions: Tensor  # of the policy's own form
    logs: Tensor  # logarithms of the actions' probabilities
    advantages: Tensor  # how much better than expected it went
    returns: Tensor  # what came of it
    learned: Tensor  # whether it is to be learned from
    rewards: Tensor  # as the device had them, and the ends
    ended: Tensor

    def parts(self) -> list[Any]:
        """Return all tensors, and None for what there is not: :meth:`of` takes them."""
        return [*self.view, *self[1:]]

    @classmethod
    def of(cls, parts: Sequence[Any]) -> Experience:
        """Return the experience of these parts."""
        others = 7
        return cls(View(*parts[:-others]), *parts[-others:])


class RolloutWorker:
    """Gathers with the agents of some blocks, by default all: see ``ppo.PPOSettings``.

    The weights of the model, which acts, may change between rollouts.
    """

    def __init__(
        self,
        spec: EnvSpec,
        device: str | Device,
        settings: Any,
        model: ActorCritic,
        blocks: range | None = None,
    ) -> None:
        self.spec, self.settings, self.model = spec, settings, model
        self.numbers = range(settings.blocks) if blocks is None else blocks
        edges = block_edges(settings, self.numbers)
        self.blocks = [slice(a - edges[0], b - edges[0]) for a, b in itertools.pairwise(edges)]
        n = edges[-1] - edges[0]
        self.agents = Agents(spec, device, n, settings.seed, edges[0], model.central)
        self.where = self.agents.obs.device

    @torch.no_grad()
    def gather(self, rollout: int) -> Experience:
        """Step all agents; return the experience of the rollout of that number."""
        settings, agents, model = self.settings, self.agents, self.model
        noise = self._noise(rollout)
        views, made, taken, steps = [agents.view], [], [], []
        acting, alive = [self.acting()], [agents.alive]
        for t in range(settings.rollout_length):
            made.append(self.decide(agents.view, t))
            actions, given = model.draw(made[-1], noise[t])
            taken.append(actions)
            steps.append(agents.step(given))
            views.append(agents.view)
            acting.append(self.acting())
            alive.append(agents.alive)
        view, actions = View.stacked(views), torch.stack(taken)
        rewards, terminations, truncations = map(torch.stack, list(zip(*steps, strict=True))[1:4])
        ended = over = terminations | truncations
        logs = model.weigh(torch.stack(made), actions).logs
        wanted = team_rewards(rewards, self.spec.agents, settings.rewards) * settings.reward_scale
        if settings.rewards != "own":  # what the others still earn counts until the whole world ends
            gone = ended | ~torch.stack(alive[:-1])
            worlds = gone.reshape(len(gone), -1, self.spec.agents).all(2)
            over = worlds.repeat_interleave(self.spec.agents, 1)
        decides = torch.stack(acting)
        values = self._values(view, decides)
        cut = truncations & ~terminations
        # Only the time limit ended it: what was to come counts. Of what a central critic is given, and of who
        # is on turn then, nothing is told.
        unknown = cut & (model.central or self.spec.turns)
        cut &= ~unknown
        unknown |= self.strays() & decides[:-1]
        if cut.any():
            final = view.pick(slice(0, -1))._replace(obs=torch.stack([step.final_obs for step in steps]))
            wanted += settings.discount * self._values(final, cut)
        course = Course(wanted, values, over, decides, unknown)
        gains, learned = advantages(course, settings.discount, settings.gae_lambda)
        return Experience(
            view.pick(slice(0, -1)), actions, logs, gains, gains + values[:-1], learned, rewards, ended
        )

    def acting(self) -> Tensor:
        """Return whose decisions are to be learned from, of those that come next."""
        return self.agents.acting

    def strays(self) -> Tensor:
        """Return which decisions of the rollout the policy did not make; they are not learned from."""
        return torch.zeros((), dtype=torch.bool, device=self.where)

    def decide(self, view: View, _: int) -> Tensor:
        """Return the policy's outputs for the rollout's step of that number."""
        if not self.spec.turns:
            return _joined([self.model.outputs(view.pick(block)) for block in self.blocks])
        rows = self.agents.acting.nonzero()[:, 0]  # of the others nothing is asked
        outputs = torch.full((len(view.obs), self.model.policy.outputs), MASKED, device=self.where)
        outputs[rows] = self.model.outputs(view.pick(rows))
        return outputs

    def _noise(self, rollout: int) -> Tensor:
        """Return what makes the rollout's actions random."""
        settings = self.settings
        size = (settings.rollout_length, len(self.agents.obs), self.model.policy.outputs)
        noise = torch.empty(size, device=self.where)
        for number, block in zip(self.numbers, self.blocks, strict=True):
            random = torch.Generator(self.where).manual_seed(seed_of(settings.seed, rollout, number))
            noise[:, block] = self.model.noise((size[0], block.stop - block.start, size[2]), random)
        return noise

    def _values(self, view: View, wanted: Tensor) -> Tensor:
        """Return what the critic expects of those wanted, else 0; a row a step and a column an agent."""
        values = torch.zeros(wanted.shape, device=self.where)
        for block in self.blocks:
            steps, columns = wanted[:, block].nonzero(as_tuple=True)
            rows = steps, columns + block.start
            for k in range(0, len(steps), ROWS):
                some = rows[0][k : k + ROWS], rows[1][k : k + ROWS]
                values[some] = self.model.values(view.pick(some))
        return values


def seed_of(*numbers: int) -> int:
    """Return a seed that these numbers make, for a generator of PyTorch."""
    return int(np.random.SeedSequence(numbers).generate_state(1, np.uint64)[0]) >> 1


def block_edges(settings: Any, blocks: range) -> list[int]:
    """Return the first agent of each of the blocks, and the end of the last."""
    return [number * settings.n_agents // settings.blocks for number in (*blocks, blocks.stop)]


def _joined(parts: list[Tensor], axis: int = 0) -> Tensor:
    return parts[0] if len(parts) == 1 else torch.cat(parts, axis)
