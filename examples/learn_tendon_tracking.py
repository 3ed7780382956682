"""Does PPO learn to follow a target with the tip of an arm that four tendons bend?

    pip install . stable-baselines3 matplotlib
    python examples/learn_tendon_tracking.py [ACTIONS] [PICTURE]

The task is that of SoRoMoX (arm of 0.25 m, 15 actions a second, 7 s, success within 10 mm; `softarm.environments.TendonTracking`), and its
policy and settings are those of their program but for the number of arms and the batch. The table has return, distance and success of random
actions, of no action, of the policy, and of a predictive controller with the model of the arm, over the same 64 targets, which were not trained
on; the picture has the mean return while learning.
"""

import sys
import time

import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecMonitor, VecNormalize

import softarm as sa
from softarm.environments import TendonTracking
from softarm.gym import ArmVectorEnv
from softarm.sb3 import ArmVecEnv, Expert

ARMS, EPISODES = 32, 64


class Curve(BaseCallback):
    """Mean return of the last 100 episodes after every round of actions."""

    def __init__(self):
        super().__init__()
        self.actions, self.returns, self.begun = [], [], time.perf_counter()

    def _on_step(self):
        return True

    def _on_rollout_end(self):
        if self.model.ep_info_buffer:
            self.actions.append(self.num_timesteps)
            self.returns.append(np.mean([episode["r"] for episode in self.model.ep_info_buffer]))
            spent = time.perf_counter() - self.begun
            print(f"{self.actions[-1]:9d} actions, {spent:5.0f} s: mean return {self.returns[-1]:7.2f}", flush=True)


def controllers(task, n, ahead=8):
    """Predictive controllers of `n` arms, which plan some actions ahead, along the target with its velocity of now."""
    keys = task.scene.to_dict()
    keys["time"]["step_s"] = task.period / 2
    for tendon in keys["tendon"]:
        tendon["rate_n_s"] = 0.5 / task.period  # as much as an action changes a tension
    # That the tip follows a path; each sample has another one.
    keys["objective"] = {"track": [{"circle": {"center_m": [0.0, 0.0, 0.23], "radius_m": 0.05, "turn_s": 10.0}}]}
    keys["mpc"] = {"period_s": task.period, "horizon_s": ahead * task.period, "block_s": task.period}
    scene = sa.Scene(keys)

    def one():
        controller, times = scene.controller(), task.period * np.arange(ahead + 1.0)[:, None]

        def plan(state, action, target):
            course = np.hstack([state.time + times, target.x + times * target.v])
            command = controller.step(sa.State(*state[:4]), time=state.time, reference=course)
            return np.array([to for _, to in command.efforts.values()]) - state.efforts

        return plan

    return [one() for _ in range(n)]


def played(policy):
    """Returns of episodes with targets of their own, mean distances and successes in the second half, under actions between -1 and 1;
    `policy` makes a function of observations for environments.
    """
    envs = ArmVecEnv(ArmVectorEnv("TendonTracking", EPISODES, autoreset_mode="SameStep"))
    envs.seed(1_000_000)
    act = policy(envs)
    seen, total, distances = envs.reset(), np.zeros(EPISODES), []
    for _ in range(envs.envs.task.steps):
        seen, rewards, _, infos = envs.step(act(seen))
        total += rewards
        distances.append([info["distance_m"] for info in infos])
    late = np.array(distances[len(distances) // 2 :])
    return total, late.mean(axis=0), (late < envs.envs.task.near).mean(axis=0)


def main(actions=300_000, picture="learn_tendon_tracking.png"):
    torch.set_num_threads(1)  # the network is small, and the arms have the other cores
    envs = VecNormalize(VecMonitor(ArmVecEnv(ArmVectorEnv("TendonTracking", ARMS, autoreset_mode="SameStep"))), clip_obs=10.0)
    model = PPO("MlpPolicy", envs, n_steps=min(200, -(-actions // ARMS)), batch_size=400, seed=0, device="cpu")
    curve = Curve()
    model.learn(actions, callback=curve)
    spent = time.perf_counter() - curve.begun

    dice = np.random.default_rng(0)
    rows = {
        "random actions": played(lambda _: lambda seen: dice.uniform(-1.0, 1.0, (EPISODES, 4))),
        "no action": played(lambda _: lambda seen: np.zeros((EPISODES, 4))),
        f"PPO, {actions} actions": played(lambda _: lambda seen: model.predict(envs.normalize_obs(seen), deterministic=True)[0]),
    }
    experts = controllers(TendonTracking(), EPISODES)
    rows["predictive controller"] = played(lambda own: lambda seen: Expert(own, experts).predict()[0])
    print(f"\nlearned in {spent:.0f} s\n")
    print("| policy | return, mean +- standard error | distance, mm, second half | within 10 mm, second half |")
    print("|---|---|---|---|")
    for name, (total, distance, near) in rows.items():
        error = total.std(ddof=1) / np.sqrt(EPISODES)
        print(f"| {name} | {total.mean():.1f} +- {error:.1f} | {1e3 * distance.mean():.1f} | {100 * near.mean():.0f} % |")
    draw(curve, rows, picture)
    return {name: total.mean() for name, (total, _, _) in rows.items()}


def draw(curve, rows, picture):
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(7, 4), constrained_layout=True)
    axes.plot(np.array(curve.actions) / 1e3, curve.returns, color="#1f5fa8", label="while learning (mean of 100 episodes)")
    for (name, (total, _, _)), style in zip(rows.items(), (":", "--", "-.", "-")):
        axes.axhline(total.mean(), color="0.3", ls=style, lw=1, label=name)
    axes.set(xlabel="actions (thousands)", ylabel="return of an episode", title=f"Tendon tracking, learned by PPO; lines: means of {EPISODES} other targets")
    axes.legend(loc="lower right", bbox_to_anchor=(1.0, 0.2))
    figure.savefig(picture, dpi=150)


if __name__ == "__main__":
    main(*map(int, sys.argv[1:2]), *sys.argv[2:3])
