"""PPO of one's own: 512 agents of CartPole, and every line of the algorithm to change as you like.

It takes torch: pip install '.[train]' in a clone. `pearl train` has a faster and more complete one.
"""

import torch
from torch import nn

import pearl_marl

AGENTS, STEPS, ITERATIONS, GAMMA, LAMBDA, CLIP = 512, 32, 30, 0.98, 0.9, 0.2

torch.set_num_threads(1)  # networks are small: more threads would mostly wait for each other
torch.manual_seed(0)
env = pearl_marl.parallel_env("CartPole", n_agents=AGENTS)
policy = nn.Sequential(nn.Linear(4, 64), nn.Tanh(), nn.Linear(64, 2))
critic = nn.Sequential(nn.Linear(4, 64), nn.Tanh(), nn.Linear(64, 1), nn.Flatten(0))
parameters = [*policy.parameters(), *critic.parameters()]
optimizer = torch.optim.Adam(parameters, lr=3e-3)

obs = torch.from_numpy(env.reset_batch(seed=0))
returns = torch.zeros(AGENTS)
for iteration in range(ITERATIONS):
    rollout, done = [], []
    for _ in range(STEPS):
        with torch.no_grad():
            chances = torch.distributions.Categorical(logits=policy(obs))
            actions = chances.sample()
            step = env.step_batch(actions.numpy())
            # Where an episode ended, `obs` begins the next one, and `arrivals` is where the old one ended.
            goes_on = 1 - torch.from_numpy(step.terminations).float()
            future = goes_on * critic(torch.from_numpy(step.arrivals()))
            rewards, ended = torch.from_numpy(step.rewards), torch.from_numpy(step.ended)
            values = critic(obs)
            surprise = rewards + GAMMA * future - values
        rollout.append((obs, actions, chances.log_prob(actions), values, surprise, ended))
        obs = torch.from_numpy(step.obs)
        returns += rewards
        done.append(returns[ended])
        returns = returns.where(~ended, 0.0)
    observed, taken, before, valued, surprises, ends = map(torch.stack, zip(*rollout, strict=True))
    advantages, following = torch.zeros_like(surprises), torch.zeros(AGENTS)
    for t in reversed(range(STEPS)):
        following = surprises[t] + GAMMA * LAMBDA * following.where(~ends[t], 0.0)
        advantages[t] = following
    targets = (advantages + valued).flatten()
    advantages = ((advantages - advantages.mean()) / advantages.std()).flatten()
    observed, taken, before = observed.flatten(0, 1), taken.flatten(), before.flatten()
    for _ in range(4):
        for rows in torch.randperm(len(taken)).split(4096):
            chances = torch.distributions.Categorical(logits=policy(observed[rows]))
            ratio = (chances.log_prob(taken[rows]) - before[rows]).exp()
            gain = torch.min(
                ratio * advantages[rows], ratio.clamp(1 - CLIP, 1 + CLIP) * advantages[rows]
            ).mean()
            error = (critic(observed[rows]) - targets[rows]).square().mean()
            loss = -gain + 0.5 * error - 0.01 * chances.entropy().mean()
            optimizer.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_(parameters, 0.5)
            optimizer.step()
    if iteration % 5 == 4:
        ended_now = torch.cat(done)
        print(f"iteration {iteration + 1}: {len(ended_now)} episodes, mean return {ended_now.mean():.0f}")

obs = env.reset_batch(seed=1)
lengths, first = torch.zeros(AGENTS), torch.ones(AGENTS, dtype=torch.bool)
for _ in range(500):
    step = env.step_batch(policy(torch.from_numpy(obs)).argmax(1).numpy())
    lengths += first
    first &= ~torch.from_numpy(step.ended)
    obs = step.obs
print(f"Greedy: mean return {lengths.mean():.0f} of 500")
