"""Does the derivative of the motion help a policy to learn? Analytic policy gradients beside PPO, by processor time.

    pip install . stable-baselines3 matplotlib
    python examples/learn_by_gradient.py [ACTIONS] [ACTIONS OF PPO] [PICTURE]

The task is `softarm.environments.TendonTracking`, as in `learn_tendon_tracking.py`, whose PPO with its settings stands beside. Both policies are
networks of two layers of 64 numbers on the same observations. The gradient goes from the distances of tip and target in 15 actions of 4 arms
through the motions (`Rollout.to_torch`), through the tensions and the actions to the network, also along what the states of the arms do to later
actions; the next 15 actions begin where these end, without it. That a tip within 10 mm earns more has no derivative and is left out in learning.

Every return is the mean of 64 episodes with targets that were not learned from, without exploration; the clock, the processor time of all threads,
stands still meanwhile.
"""

import sys
import time

import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecMonitor, VecNormalize

from softarm.environments import TendonTracking
from softarm.gym import ArmVectorEnv
from softarm.sb3 import ArmVecEnv

ARMS, EPISODES = 32, 64
"""Arms of PPO, and episodes of a mean."""
FEW, WINDOW, RATE = 4, 15, 5e-3
"""Arms and actions of a gradient, and the rate of learning, which falls to zero."""


def returns(act):
    """Returns the mean return of actions between -1 and 1 as a function of observations."""
    envs = ArmVecEnv(ArmVectorEnv("TendonTracking", EPISODES, autoreset_mode="SameStep"))
    envs.seed(1_000_000)
    seen, total = envs.reset(), np.zeros(EPISODES)
    for _ in range(envs.envs.task.steps):
        seen, rewards, _, _ = envs.step(act(seen))
        total += rewards
    return total.mean()


class Clock:
    """Processor time and return of a policy while it learns."""

    def __init__(self, name):
        self.name, self.spent, self.rows, self.last, self.next = name, 0.0, [], time.process_time(), 0

    def look(self, actions, act):
        self.spent += time.process_time() - self.last
        self.rows.append((actions, self.spent, returns(act)))
        print(f"{self.name:9s} {actions:7d} actions {self.spent:7.1f} s: mean return {self.rows[-1][2]:7.2f}", flush=True)
        self.last = time.process_time()


class Policy(torch.nn.Module):
    """Actions between -1 and 1 of observations, which are divided by their sizes."""

    sizes = torch.tensor([*[0.1] * 3, *[0.1] * 3, *[10.0] * 4, *[0.1] * 3, *[0.015] * 3])

    def __init__(self):
        super().__init__()
        layers = [torch.nn.Linear(16, 64), torch.nn.Tanh(), torch.nn.Linear(64, 64), torch.nn.Tanh(), torch.nn.Linear(64, 4)]
        torch.nn.init.zeros_(layers[-1].weight)
        self.layers = torch.nn.Sequential(*layers)

    def forward(self, seen):
        return torch.tanh(self.layers(seen / self.sizes))

    def act(self, seen):
        with torch.no_grad():
            return self(torch.as_tensor(seen, dtype=torch.float32)).numpy()


def learn(actions, seed=0):
    """Learns by gradients through the motions; returns the clock and the policy."""
    torch.manual_seed(seed)
    task, dice = TendonTracking(), np.random.default_rng(seed)
    move = task.scene.rollout(task.period).to_torch()
    policy, clock, done = Policy(), Clock("gradients"), 0
    adam = torch.optim.Adam(policy.parameters(), lr=RATE)
    plain = task.scene.plant().state
    while done < actions:
        course = torch.tensor(np.stack([task.path(dice) for _ in range(FEW)], axis=1))
        state = [torch.tensor(np.repeat(part[None], FEW, axis=0)) for part in plain]
        efforts = torch.zeros(FEW, 4, dtype=torch.float64)
        for first in range(0, task.steps, WINDOW):
            state, efforts, loss = [part.detach() for part in state], efforts.detach(), 0.0
            for k in range(first, first + WINDOW):
                target, way = course[k], (course[k + 1] - course[k]) / task.period
                seen = torch.cat([state[0][:, -1], state[2][:, -1], efforts, target, way], dim=1)
                efforts = efforts + 0.5 * policy(seen.float()).double()
                # The derivative is that without bounds, or tensions that became zero would stay so.
                efforts = efforts + (efforts.clamp(0.0, task.most) - efforts).detach()
                parts = move(efforts[:, None], start=state)
                state = [part[:, -1] for part in parts]
                loss = loss + (state[0][:, -1] - course[k + 1]).norm(dim=1).mean() / 0.2
            adam.zero_grad()
            loss.backward()
            torch.nn.utils.clip_grad_norm_(policy.parameters(), 1.0)
            adam.step()
            for group in adam.param_groups:
                group["lr"] = RATE * (1.0 - done / actions)
        done += FEW * task.steps
        if done >= clock.next or done >= actions:
            clock.next = 1.4 * done
            clock.look(done, policy.act)
    return clock, policy


class Watch(BaseCallback):
    def __init__(self, clock, envs):
        super().__init__()
        self.clock, self.envs = clock, envs

    def _on_step(self):
        return True

    def _on_rollout_end(self):
        if self.num_timesteps // (ARMS * 200) % 4 == 1:
            self.clock.look(self.num_timesteps, lambda seen: self.model.predict(self.envs.normalize_obs(seen), deterministic=True)[0])


def learn_by_ppo(actions):
    """Learns by PPO with the settings of `learn_tendon_tracking.py`."""
    envs = VecNormalize(VecMonitor(ArmVecEnv(ArmVectorEnv("TendonTracking", ARMS, autoreset_mode="SameStep"))), clip_obs=10.0)
    model = PPO("MlpPolicy", envs, n_steps=min(200, -(-actions // ARMS)), batch_size=400, seed=0, device="cpu")
    clock = Clock("PPO")
    watch = Watch(clock, envs)
    model.learn(actions, callback=watch)
    clock.look(model.num_timesteps, lambda seen: model.predict(envs.normalize_obs(seen), deterministic=True)[0])
    return clock


def main(actions=80_000, of_ppo=300_000, picture="learn_by_gradient.png"):
    torch.set_num_threads(1)
    clocks = [learn(actions)[0], learn_by_ppo(of_ppo)]
    draw(clocks, picture)
    return clocks


def draw(clocks, picture):
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(7, 4), constrained_layout=True)
    for clock, color in zip(clocks, ("#1f5fa8", "#b5541c")):
        actions, spent, mean = zip(*clock.rows)
        axes.semilogx(spent, mean, "o-", ms=3, color=color, label=f"{clock.name}, {actions[-1] / 1e3:.0f} thousand actions")
    axes.set(xlabel="processor time of learning, s", ylabel=f"return, mean of {EPISODES} other targets", title="Tendon tracking")
    axes.legend(loc="lower right")
    figure.savefig(picture, dpi=150)


if __name__ == "__main__":
    main(*map(int, sys.argv[1:3]), *sys.argv[3:4])
