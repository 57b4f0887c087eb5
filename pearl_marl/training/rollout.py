"""A rollout: agents act by a policy that stays as it is for some steps, and advantages are estimated.

What is gathered depends on the weights, the agents' state and the rollout's number alone. However the agents
are divided among workers, the rollout is the same.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from pearl_marl.devices import Device
from pearl_marl.policies.dense_policy import DenseNetwork
from pearl_marl.policies.network import MASKED
from pearl_marl.policies.second_thread import begun
from pearl_marl.spec import EnvSpec
from pearl_marl.training.actor_critic import Inputs
from pearl_marl.training.agents import Agents, acting, team_rewards

CRITIC_ROWS = 16_384
"""Observations that the critic is given at a time, which bounds the memory of its layers."""


class RolloutBuffer(NamedTuple):
    """What agents did: a row for each step and a column for each agent, or a row for each sample."""

    inputs: Inputs
    actions: Tensor  # in the policy's own form
    log_probs: Tensor  # of the actions
    advantages: Tensor
    returns: Tensor  # what the critic should have expected
    loss_mask: Tensor  # which samples are learned from
    rewards: Tensor  # from the device
    ended: Tensor  # which episodes ended

    def flat(self) -> RolloutBuffer:
        """Return steps and agents as one axis; without memories, which not every step has."""
        steps = self._replace(inputs=self.inputs._replace(memory=None))
        return steps.map(lambda tensor: tensor.flatten(0, 1))

    def pick(self, rows: Any) -> RolloutBuffer:
        """Return some rows."""
        return self.map(lambda tensor: tensor[rows])

    def map(self, function: Callable[[Tensor], Any]) -> RolloutBuffer:
        """Return what a function makes of every tensor."""
        return RolloutBuffer(self.inputs.map(function), *map(function, self[1:]))


class RolloutSteps(NamedTuple):
    """What agents did and got: a row for each step and a column for each agent."""

    inputs: Inputs  # with a row more, for where the last step led
    final_obs: Tensor  # of the episodes that ended
    rewards: Tensor
    terminations: Tensor
    truncations: Tensor
    values: Tensor | None  # what the critic expects where agents decide, if that was found with the outputs
    outputs: Tensor  # of the policy
    actions: Tensor  # in its own form
    acting: Tensor  # which agents decide; with a row more
    alive: Tensor  # which take part; with a row more


class RolloutWorker:
    """Gathers with the agents of some blocks, by default all: see ``settings.BlockSettings``.

    The weights of the model, by which they act, may change between rollouts. It is an
    :class:`~pearl_marl.training.actor_critic.ActorCritic` or
    :class:`~pearl_marl.training.action_values.ActionValues`.
    """

    def __init__(
        self,
        spec: EnvSpec,
        device: str | Device,
        settings: Any,
        model: Any,
        blocks: range | None = None,
    ) -> None:
        self.spec, self.settings, self.model = spec, settings, model
        self.numbers = range(settings.blocks) if blocks is None else blocks
        edges = block_edges(settings, self.numbers)
        self.blocks = [slice(a - edges[0], b - edges[0]) for a, b in itertools.pairwise(edges)]
        n = edges[-1] - edges[0]
        self.agents = Agents(spec, device, n, settings.seed, edges[0], model.central)
        self.where = self.agents.obs.device
        # What the critic expects of each step so far, if decide() finds that, too; see RolloutSteps.values.
        self.expects: list[Tensor] = []
        # Functions that return the noise that has been begun, by the number of its rollout.
        self._begun: dict[int, Callable[[], Tensor]] = {}

    @torch.no_grad()
    def gather(self, rollout: int) -> RolloutBuffer:
        """Step all agents ``rollout_length`` times; return the rollout of that number."""
        settings, model, steps = self.settings, self.model, self.settings.rollout_length
        self.expects.clear()
        begun_before = self._begun.pop(rollout, None)
        noise = self._made_noise(rollout) if begun_before is None else begun_before()
        network = self.network_beside()
        done = self._one_by_one(noise) if network is None else self._at_once(network, noise)
        inputs, final_obs, rewards, terminations, truncations, _, outputs, chosen, decides, alive = done
        log_probs = model.log_probs(outputs, chosen)
        ended = over = terminations | truncations
        wanted = team_rewards(rewards, self.spec.agents, settings.rewards) * settings.reward_scale
        if settings.rewards != "own":  # what the others still earn counts until the whole world ends
            left = ended | ~alive[:-1]
            worlds = left.reshape(steps, -1, self.spec.agents).all(2)
            over = worlds.repeat_interleave(self.spec.agents, 1)
        values = self._mixed(self.expected(done), inputs.state)
        cut = truncations & ~terminations
        # Only the time limit ended these episodes: what was to come counts. The device tells neither the
        # state that a central critic would be given then, nor the agent that would have been on turn, nor
        # the masks, without which the best action may be one that is forbidden.
        unmasked = model.of_best and inputs.masks is not None
        unknown = cut & (model.central or self.spec.turns or unmasked)
        cut &= ~unknown
        unknown |= self.excluded() & decides[:-1]
        if cut.any():
            final = inputs.pick(slice(0, -1))._replace(obs=final_obs, masks=None)
            wanted += settings.discount * self._mixed(self.values_where(final, cut), final.state)
        trajectories = Trajectories(wanted, values, over, self._any(decides), self._any(unknown))
        advantages, mask = estimated_advantages(trajectories, settings.discount, settings.gae_lambda)
        mask &= decides[:-1]
        inputs = inputs.pick(slice(0, -1))
        return RolloutBuffer(
            inputs, chosen, log_probs, advantages, advantages + values[:-1], mask, rewards, ended
        )

    def network_beside(self) -> DenseNetwork | None:
        """Return what chooses the actions of a whole rollout, if that can be done beside the agents.

        It is None where :meth:`decide`, :meth:`acting` or the model's ``draw`` is of another kind.
        """
        return self.agents.network_beside(self.model.policy)

    def _at_once(self, network: DenseNetwork, noise: Tensor) -> RolloutSteps:
        """Do all steps in one call of the device."""
        made = self.agents.experience(network, noise)
        masks = None if made.action_masks is None else torch.from_numpy(made.action_masks)
        position, alive = self.agents.position, torch.from_numpy(made.in_episode)
        if position is not None:
            position = position.expand(len(alive), -1)
        words, outputs = torch.from_numpy(made.words), torch.from_numpy(made.outputs)
        return RolloutSteps(
            inputs=Inputs(torch.from_numpy(made.observations), masks, position),
            final_obs=torch.from_numpy(made.final_observations),
            rewards=torch.from_numpy(made.rewards),
            terminations=torch.from_numpy(made.terminations),
            truncations=torch.from_numpy(made.truncations),
            outputs=outputs,
            actions=words if self.model.policy.heads else words[..., 0],
            acting=acting(alive, masks),
            alive=alive,
            values=outputs.amax(-1) if self.model.of_best else None,
        )

    def _one_by_one(self, noise: Tensor) -> RolloutSteps:
        """Do one step after the other."""
        agents, model, steps = self.agents, self.model, len(noise)
        # Filled step by step, as the device writes over its results. Inputs have a row more: where the last
        # step led.
        inputs = agents.inputs.map(lambda now: now.new_empty((steps + 1, *now.shape)))
        final_obs = agents.obs.new_empty((steps, *agents.obs.shape))
        rewards = torch.empty((steps, len(agents.obs)), device=self.where)
        terminations, truncations = (torch.empty_like(rewards, dtype=torch.bool) for _ in range(2))
        noted: tuple[list[Tensor], ...] = [], [], [], []
        outputs, actions, decides, alive = noted
        for t in range(steps + 1):
            for rows, now in zip(inputs, agents.inputs, strict=True):
                if rows is not None and now is not None:
                    rows[t] = now
            decides.append(self.acting())
            alive.append(agents.alive)
            if t == steps:
                break
            outputs.append(self.decide(agents.inputs, t))
            chosen, taken = model.draw(outputs[t], noise[t])
            actions.append(chosen)
            _, rewards[t], terminations[t], truncations[t], final_obs[t] = agents.step(taken)
        values = torch.stack(self.expects) if self.expects else None
        results = final_obs, rewards, terminations, truncations, values
        return RolloutSteps(inputs, *results, *map(torch.stack, noted))

    def acting(self) -> Tensor:
        """Return which agents' next decisions are learned from."""
        return self.agents.acting

    def excluded(self) -> Tensor:
        """Return which decisions of the rollout the policy did not make; they are not learned from."""
        return torch.zeros((), dtype=torch.bool, device=self.where)

    def decide(self, inputs: Inputs, _: int) -> Tensor:
        """Return the policy's outputs for the rollout's step of that number.

        Note what the critic expects, if the same layers find it.
        """
        parts = [self._asked(inputs.pick(block), self.agents.acting[block]) for block in self.blocks]
        outputs, values = map(torch.cat, zip(*parts, strict=True)) if len(parts) > 1 else parts[0]
        if self.model.shared:
            self.expects.append(values)
        return outputs

    def _asked(self, inputs: Inputs, acting: Tensor) -> tuple[Tensor, Tensor]:
        """Return the outputs for a block, and what the critic expects; 0 where that takes layers of its own.

        In games of turns, agents that wait are asked nothing.
        """
        if not self.spec.turns:
            return self._answers(inputs)
        outputs = torch.full((len(acting), self.model.policy.outputs), MASKED, device=self.where)
        values, rows = torch.zeros(len(acting), device=self.where), acting.nonzero()[:, 0]
        outputs[rows], values[rows] = self._answers(inputs.pick(rows))
        return outputs, values

    def _answers(self, inputs: Inputs) -> tuple[Tensor, Tensor]:
        """Return the same for agents that all act."""
        if self.model.shared:
            outputs, values = self.model(inputs)
            return outputs, values
        return self.model.outputs(inputs), torch.zeros(len(inputs.obs), device=self.where)

    def begin_noise(self, rollout: int) -> None:
        """Have a second thread make the noise of a rollout that comes next: it depends on no weights."""
        self._begun = {rollout: begun(partial(self._made_noise, rollout))}

    def _made_noise(self, rollout: int) -> Tensor:
        """Return the noise that makes the rollout's actions random."""
        settings = self.settings
        size = (settings.rollout_length, len(self.agents.obs), self.model.policy.outputs)
        noise = torch.empty(size, device=self.where)
        for number, block in zip(self.numbers, self.blocks, strict=True):
            random = torch.Generator(self.where).manual_seed(seed_of(settings.seed, rollout, number))
            shape = (size[0], block.stop - block.start, size[2])
            noise[:, block] = self.model.noise(shape, random, rollout / settings.iterations)
        return noise

    def expected(self, steps: RolloutSteps) -> Tensor:
        """Return what the critic expects where agents decide; a row more than the rollout has steps."""
        if steps.values is None:
            return self.values_where(steps.inputs, steps.acting)
        last = self.values_where(steps.inputs.pick(slice(-1, None)), steps.acting[-1:])
        return torch.cat((steps.values.masked_fill(~steps.acting[:-1], 0), last))

    def _mixed(self, values: Tensor, state: Tensor | None) -> Tensor:
        """Return, for each agent, the value of its team, if a mixer makes one of the agents' values."""
        mixer, agents = self.model.mixer, self.spec.agents
        if mixer is None:
            return values
        states = [None] * len(values) if state is None else state[:, ::agents]
        worlds = values.reshape(len(values), -1, agents)
        teams = torch.stack([mixer(*step) for step in zip(worlds, states, strict=True)])
        return teams.repeat_interleave(agents, 1)

    def _any(self, flags: Tensor) -> Tensor:
        """Return, for each agent, its own flag; with a mixer, whether any of its team has it."""
        agents = self.spec.agents
        if self.model.mixer is None:
            return flags
        return flags.reshape(len(flags), -1, agents).any(2).repeat_interleave(agents, 1)

    def values_where(self, inputs: Inputs, wanted: Tensor) -> Tensor:
        """Return what the critic expects where it is wanted, else 0; a row a step and a column an agent."""
        if len(self.blocks) == 1 and wanted.all():  # no need to look for rows, and to copy them
            # Parts hold whole worlds.
            rows, size = inputs.flat(), CRITIC_ROWS // self.spec.agents * self.spec.agents
            parts = [rows.pick(slice(k, k + size)) for k in range(0, len(rows.obs), size)]
            return torch.cat([self.model.values_of_all(part) for part in parts]).view(wanted.shape)
        values = torch.zeros(wanted.shape, device=self.where)
        for block in self.blocks:
            steps, columns = wanted[:, block].nonzero(as_tuple=True)
            for k in range(0, len(steps), CRITIC_ROWS):
                some = steps[k : k + CRITIC_ROWS], columns[k : k + CRITIC_ROWS] + block.start
                values[some] = self.model.values(inputs.pick(some))
        return values


class Trajectories(NamedTuple):
    """What advantages depend on: a row for each step and a column for each agent."""

    rewards: Tensor  # with the discounted value of what was to come, where a time limit cut it off
    values: Tensor  # the critic's; with a row more, for where the last step led
    ended: Tensor
    acting: Tensor  # which agents decided something; with a row more
    unknown: Tensor  # where it is not known what was to come after this step


def estimated_advantages(
    trajectories: Trajectories, discount: float, gae_lambda: float
) -> tuple[Tensor, Tensor]:
    """Return generalised advantage estimates (arXiv:1506.02438), and which steps can be learned from.

    Agents need not act in every step. One that waits for its turn, or for its world to end, has nothing to
    decide. What it earns meanwhile belongs to its last decision, which led to where it decides again.
    """
    if trajectories.acting.all() and not trajectories.unknown.any():
        return _of_every_step(trajectories, discount, gae_lambda), trajectories.acting[:-1]
    return _of_decisions(trajectories, discount, gae_lambda)


def _of_every_step(trajectories: Trajectories, discount: float, gae_lambda: float) -> Tensor:
    values = trajectories.values
    going_on = (~trajectories.ended).float() * discount
    errors = trajectories.rewards + values[1:] * going_on - values[:-1]
    going_on *= gae_lambda
    advantages = torch.empty_like(errors)
    advantage = torch.zeros_like(errors[0])
    for t in reversed(range(len(errors))):
        advantage = torch.addcmul(errors[t], going_on[t], advantage)
        advantages[t] = advantage
    return advantages


def _of_decisions(trajectories: Trajectories, discount: float, gae_lambda: float) -> tuple[Tensor, Tensor]:
    """Return the same where steps lie between an agent's decisions; those are not discounted.

    A decision is not learned from if it is not known where it led. The one before it goes by its value.
    """
    rewards, values, ended, acting, unknown = trajectories
    advantages, mask = torch.zeros_like(rewards), acting[:-1].clone()
    # Of the decision that comes next: its value and advantage, whether it is known, what is earned before it.
    value, advantage = values[-1] * acting[-1], torch.zeros_like(rewards[0])
    known, earned = acting[-1], torch.zeros_like(rewards[0])
    for t in reversed(range(len(rewards))):
        over, acts = ended[t], acting[t]
        value, advantage, earned = (part.masked_fill(over, 0) for part in (value, advantage, earned))
        known = (known | over) & ~unknown[t]
        earned = earned + rewards[t]
        new = earned + discount * value - values[t] + discount * gae_lambda * advantage
        new = new.masked_fill(~known, 0)
        advantages[t] = new.masked_fill(~acts, 0)
        mask[t] &= known
        value, advantage = torch.where(acts, values[t], value), torch.where(acts, new, advantage)
        known, earned = known | acts, earned.masked_fill(acts, 0)
    return advantages, mask


def seed_of(*numbers: int) -> int:
    """Return a seed that these numbers make, for a generator of PyTorch."""
    return int(np.random.SeedSequence(numbers).generate_state(1, np.uint64)[0]) >> 1


def block_edges(settings: Any, blocks: range) -> list[int]:
    """Return the first agent of each of the blocks, and the end of the last."""
    return [number * settings.n_agents // settings.blocks for number in (*blocks, blocks.stop)]
