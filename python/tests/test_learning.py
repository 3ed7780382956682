"""Environments, their adapters and the examples of other packages; each test is left out where its package is absent."""

import ast
import copy
import importlib.util
import pickle
import runpy
import subprocess
import sys
import warnings
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import softarm as sa
from softarm import elastica, environments, policies
from softarm import mujoco as chains

EXAMPLES = Path(__file__).parents[2] / "examples"
NAMES = sorted(environments.TASKS)
BROKEN = {"rod.material.youngs_modulus_pa": 1.0}  # no arm: its model breaks down under any action


@pytest.fixture
def gymnasium():
    gymnasium = pytest.importorskip("gymnasium")
    import softarm.gym  # noqa: F401

    return gymnasium


class Short(environments.TendonTracking):
    """Episodes of four actions."""

    steps = 4


def test_importing_softarm_needs_no_gymnasium():
    words = "import softarm, softarm.environments, softarm.policies, softarm.elastica, softarm.mujoco, sys; sys.exit(bool({'gymnasium', 'mujoco'} & set(sys.modules)))"
    assert subprocess.run([sys.executable, "-c", words]).returncode == 0


@pytest.mark.parametrize("name", NAMES)
def test_environments_keep_the_rules_of_gymnasium(gymnasium, name, monkeypatch):
    """The checker of Gymnasium has nothing to say, also of both render modes, but that actions between -1 and 1 would be better; of such it has
    nothing to say at all.
    """
    from gymnasium.utils.env_checker import check_env

    bare = importlib.util.find_spec("matplotlib") is None
    monkeypatch.setenv("MPLBACKEND", "agg")
    env = gymnasium.make(f"softarm/{name}-v0")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(gymnasium.make(f"softarm/{name}-v0", scaled=True).unwrapped, skip_render_check=bare)
        warnings.filterwarnings("ignore", message=".*symmetric and normalized")
        check_env(env.unwrapped, skip_render_check=bare)
    assert env.metadata["render_fps"] == max(1, round(1.0 / env.unwrapped.task.period))
    first, told = env.reset(seed=7)
    assert np.array_equal(env.reset(seed=7)[0], first) and not np.array_equal(env.reset(seed=8)[0], first)
    # The tip is the last node that is observed, and the target has the last six numbers.
    task, n = env.unwrapped.task, len(first)
    tip, target = first[3 * len(task.nodes) - 3 : 3 * len(task.nodes)], first[n - 6 : n - 3]
    assert np.linalg.norm(tip - target) == pytest.approx(told["distance_m"], rel=1e-6)
    assert pickle.loads(pickle.dumps(env.spec)) == env.spec
    assert gymnasium.make_vec(f"softarm/{name}-v0", num_envs=2, vectorization_mode="vector_entry_point").reset(seed=7)[0].shape == (2, n)


@pytest.mark.parametrize("name", NAMES)
def test_paths_of_targets_are_as_fast_as_said(name):
    task = environments.TASKS[name]()
    for seed in range(5):
        path = task.path(np.random.default_rng(seed))
        assert path.shape == (task.steps + 1, 3) and np.isfinite(path).all()
        speed = np.linalg.norm(np.diff(path, axis=0), axis=1) / task.period
        if name == "ElasticaCase1":
            inside = (path >= task.box[:, 0] + task.ball - 1e-12) & (path <= task.box[:, 1] - task.ball + 1e-12)
            assert inside.all() and speed.max() <= task.speed * (1 + 1e-9)
            # Slower only where a wall reflects it within an action.
            assert np.median(speed) == pytest.approx(task.speed, rel=1e-9)
        if name == "TendonTracking":
            # Chords of the course, whose curvature over a step is below 1 / 10 mm.
            assert np.allclose(np.linalg.norm(path - task.center, axis=1), task.radius)
            assert speed.max() <= task.speed * (1 + 1e-3)
        if name == "ChamberTracking":
            radius = np.hypot(path[0, 0], path[0, 1])
            assert speed.max() <= 2 * np.pi * radius / task.turns[0] * (1 + 1e-9)


def test_pressures_at_rest_hold_the_module():
    """Without actions the arm stays where it hangs; as much more pressure in all chambers stretches it, and does not bend it."""
    arms = environments.Arms(environments.ChamberTracking(), 1)
    arms.reset([0], [np.random.default_rng(0)])
    before = arms.batch.positions[0, -1]
    for _ in range(4):
        arms.step(np.zeros((1, 3)))
    assert np.abs(arms.batch.positions[0, -1] - before).max() < 1e-9
    for _ in range(20):
        arms.step(np.full((1, 3), 5e3 / 20))
    after = arms.batch.positions[0, -1]
    # Three chambers of 39.3 mm^2 under 5 kPa more pull the 50 mm of 63.43 N by 0.46 mm.
    assert before[2] - after[2] == pytest.approx(3 * 3.927e-5 * 5e3 / 63.43 * 0.05, rel=0.05) and np.abs(after[:2]).max() < 1e-6


def test_a_target_may_stay():
    task = environments.SoftArmTracking(target=(0.5, 0.5, 0.5))
    assert (task.path(np.random.default_rng(0)) == 0.5).all()
    with pytest.raises(ValueError, match="three finite numbers"):
        environments.SoftArmTracking(target=(0.5, np.nan, 0.5))


@pytest.mark.parametrize("mode", ["NextStep", "SameStep", "Disabled"])
@pytest.mark.parametrize("name", [*NAMES, "breaking"])
def test_a_vector_does_what_single_environments_do_to_the_byte(gymnasium, mode, name, monkeypatch):
    """Everything that is returned agrees with `SyncVectorEnv` over single environments: through resets, and through breakdowns."""
    from gymnasium.vector import SyncVectorEnv
    from softarm.gym import ArmEnv, ArmVectorEnv

    class Episode(environments.TASKS.get(name, environments.TendonTracking)):
        steps = 5

    options = {"changes": BROKEN} if name == "breaking" else {}
    n = 9  # more than a vector of the processor has
    single = SyncVectorEnv([lambda: ArmEnv(Episode(**options))] * n, autoreset_mode=mode)
    vector = ArmVectorEnv(Episode(**options), n, threads=2, autoreset_mode=mode)
    assert vector.metadata["autoreset_mode"] == single.metadata["autoreset_mode"]
    assert vector.observation_space == single.observation_space and vector.action_space == single.action_space
    seeds = [5, None, *range(7)]
    same(vector.reset(seed=11), single.reset(seed=11))
    same(vector.reset(seed=seeds), single.reset(seed=seeds))
    vector.action_space.seed(2)
    broken = 0
    for _ in range(12):
        actions = vector.action_space.sample()
        ours, theirs = vector.step(actions), single.step(actions)
        same(ours, theirs)
        assert np.isfinite(ours[0]).all() and np.isfinite(ours[1]).all()
        broken += ours[2].sum()
        over = ours[2] | ours[3]
        if mode == "Disabled" and over.any():
            with pytest.raises(gymnasium.error.ResetNeeded):
                vector.step(actions)
            same(vector.reset(options={"reset_mask": over}), single.reset(options={"reset_mask": over}))
    assert (broken > 0) == (name == "breaking")


def same(a, b):
    """Asserts that two answers are equal to the byte, with what is in their dictionaries."""
    assert type(a) is type(b) or isinstance(a, (np.ndarray, np.generic))
    if isinstance(a, dict):
        assert set(a) == set(b)
        for key in a:
            same(a[key], b[key])
    elif isinstance(a, tuple):
        assert len(a) == len(b)
        for pair in zip(a, b):
            same(*pair)
    elif isinstance(a, (bool, float, str)):
        assert a == b
    elif a.dtype == object:
        for pair in zip(a, b):
            assert np.array_equal(*pair)
    else:
        assert a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes()


def test_a_broken_arm_ends_its_episode_and_says_why(gymnasium):
    env = gymnasium.make("softarm/SoftArmTracking-v0", changes=BROKEN).unwrapped
    env.reset(seed=0)
    terminated, n = False, 0
    while not terminated and n < 100:
        seen, reward, terminated, truncated, info = env.step(env.action_space.high)
        n += 1
    assert terminated and not truncated and reward == env.task.lost and info["error"]
    assert env.observation_space.contains(seen) and np.isfinite(seen).all()
    seen, info = env.reset(seed=0)
    assert "error" not in info and np.array_equal(seen, env.reset(seed=0)[0])


def test_faults_of_actions_and_options_are_named(gymnasium):
    from softarm.gym import ArmEnv, ArmVectorEnv

    env = ArmEnv("TendonTracking")
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.step(np.zeros(4))
    env.reset(seed=0)
    with pytest.raises(ValueError, match=r"actions\[0, 2\] is nan"):
        env.step(np.array([0.0, 0.0, np.nan, 0.0]))
    with pytest.raises(ValueError, match="shape"):
        env.step(np.zeros(3))
    with pytest.raises(ValueError, match="reset_mask"):
        env.reset(options={"reset_mask": np.array([True])})
    with pytest.raises(ValueError, match="TendonTracking"):
        ArmEnv("TendonTraking")
    with pytest.raises(sa.SceneError):
        ArmEnv("TendonTracking", changes={"rod.elemens": 3})
    vector = ArmVectorEnv("TendonTracking", 2)
    with pytest.raises(gymnasium.error.ResetNeeded):
        vector.step(np.zeros((2, 4)))
    with pytest.raises(ValueError, match="at least one"):
        vector.reset(options={"reset_mask": np.zeros(2, dtype=bool)})


def test_actions_beyond_their_bounds_are_cut_off(gymnasium):
    from softarm.gym import ArmEnv

    env, other = ArmEnv(Short()), ArmEnv(Short())
    env.reset(seed=1), other.reset(seed=1)
    assert np.array_equal(env.step(100.0 * env.action_space.high)[0], other.step(env.action_space.high)[0])


def reward_of_effort(state, action, target):
    return -np.linalg.norm(state.x[-1] - target.x) - 0.01 * np.sum(action**2)


def observation_of_error(state, action, target):
    return np.concatenate([state.x[-1] - target.x, state.efforts, action])


def softer(rng):
    return float(10.0 ** rng.uniform(5.0, 5.5))


RANDOM = {"rod.material.density_kg_m3": (800.0, 1300.0), "rod.material.youngs_modulus_pa": softer, "gravity.acceleration_m_s2": ([0, 0, -10], [0, 0, -9])}


@pytest.mark.parametrize(
    "own", [{}, {"reward": reward_of_effort, "observation": observation_of_error, "random": {"gravity.acceleration_m_s2": ([0, 0, -10], [0, 0, -9])}}]
)
@pytest.mark.parametrize("way", ["pickle", "deepcopy"])
@pytest.mark.parametrize("name", NAMES)
def test_a_copy_goes_on_as_the_environment(gymnasium, name, way, own):
    """To the bit, from within an episode, on to its end and into the next one; and the two do not act on each other."""
    from softarm.gym import ArmEnv, ArmVectorEnv

    def copied(env):
        return pickle.loads(pickle.dumps(env)) if way == "pickle" else copy.deepcopy(env)

    class Episode(environments.TASKS[name]):
        steps = 9

    globals()["Episode"], Episode.__qualname__ = Episode, "Episode"  # where pickle finds it
    env = ArmEnv(Episode(), **own)
    env.reset(seed=3)
    env.action_space.seed(3)
    for _ in range(4):
        env.step(env.action_space.sample())
    other, at_start = copied(env), copied(env)
    for _ in range(3):
        for _ in range(9):
            action = env.action_space.sample()
            same(other.step(action), env.step(action))
            if env.arms.taken[0] == 9:
                same(other.reset(), env.reset())
    assert at_start.arms.taken[0] == 4

    vector = ArmVectorEnv(Episode(), 3, autoreset_mode="SameStep", **own)
    vector.reset(seed=3)
    vector.action_space.seed(3)
    for _ in range(4):
        vector.step(vector.action_space.sample())
    other = copied(vector)
    for _ in range(12):
        actions = vector.action_space.sample()
        same(other.step(actions), vector.step(actions))


def test_copies_of_broken_arms_stay_broken(gymnasium):
    arms = environments.Arms(environments.SoftArmTracking(changes=BROKEN), 2)
    arms.reset([0, 1], [np.random.default_rng(0)] * 2)
    errors = [None]
    while errors[0] is None:
        errors = arms.step(np.full((2, 8), 40.0))[3]
    for other in (copy.deepcopy(arms), pickle.loads(pickle.dumps(arms))):
        assert other.step(np.zeros((2, 8)))[3] == errors and np.array_equal(other.batch.positions, arms.batch.positions)


def test_rewards_and_observations_are_functions(gymnasium):
    """Those that the task has, said again as functions, give the same numbers; others give theirs."""
    from softarm.gym import ArmEnv

    task = environments.TendonTracking()

    def observation(state, action, target):
        return np.concatenate([state.x[-1], state.v[-1], state.efforts, target.x, target.v])

    def reward(state, action, target):
        off, speed = state.x[-1] - target.x, state.v[-1] - target.v
        distance = np.sqrt(off @ off)
        return -(distance / 0.2 + max(off @ speed / distance, 0.0) / 0.3) + 1.5 * (distance < task.near)

    plain, own = ArmEnv(task), ArmEnv(task, reward=reward, observation=observation)
    assert np.array_equal(plain.reset(seed=4)[0], own.reset(seed=4)[0])
    for _ in range(10):
        action = plain.action_space.sample()
        (a, ra, *_), (b, rb, *_) = plain.step(action), own.step(action)
        assert np.array_equal(a, b) and ra == pytest.approx(rb, rel=1e-12)
        # Methods of the task are these functions, too.
        assert task.reward(*plain.arms.moment(0)) == ra
        assert np.array_equal(task.observation(*plain.arms.moment(0)).astype(np.float32), a)
    env = gymnasium.make("softarm/TendonTracking-v0", reward=reward_of_effort, observation=observation_of_error)
    assert env.reset(seed=0)[0].shape == env.observation_space.shape == (11,)
    action = np.array([0.5, 0.0, -0.5, 0.0], dtype=np.float32)
    seen, reward, _, _, info = env.step(action)
    assert reward == pytest.approx(-info["distance_m"] - 0.01 * 0.5) and np.array_equal(seen[7:], action)
    # A task that is given is not changed.
    assert ArmEnv(task).observation_space.shape == (16,)
    with pytest.raises(ValueError, match="shape"):
        ArmEnv(task, observation=lambda state, action, target: state.x)


def test_random_keys_are_drawn_by_the_seed_and_act(gymnasium):
    """The seed gives the values, which `info` has, and the arm moves as one with these values does; the target is that without random keys."""
    from softarm.gym import ArmEnv, ArmVectorEnv

    env = ArmEnv("TendonTracking", random=RANDOM)
    _, info = env.reset(seed=5)
    drawn = info["parameters"]
    assert 800.0 <= drawn["rod.material.density_kg_m3"] <= 1300.0 and -10 <= drawn["gravity.acceleration_m_s2"][2] <= -9
    again = env.reset(seed=5)[1]["parameters"]
    assert again.keys() == drawn.keys() and all(np.array_equal(again[key], drawn[key]) for key in drawn)
    assert env.reset(seed=6)[1]["parameters"]["rod.material.density_kg_m3"] != drawn["rod.material.density_kg_m3"]
    env.reset(seed=5)
    known = ArmEnv("TendonTracking", changes=drawn)
    assert known.reset(seed=5)[1] == {key: info[key] for key in ("distance_m", "is_success")}
    for _ in range(5):
        action = known.action_space.sample()
        seen, reward, _, _, told = env.step(action)
        same((seen, np.float64(reward)), (lambda a, b, *_: (a, np.float64(b)))(*known.step(action)))
        assert told["parameters"].keys() == drawn.keys()
    vector = ArmVectorEnv("TendonTracking", 2, random=RANDOM)
    infos = vector.reset(seed=5)[1]["parameters"]
    assert infos["rod.material.density_kg_m3"][0] == drawn["rod.material.density_kg_m3"] and infos["gravity.acceleration_m_s2"].shape == (2, 3)
    with pytest.raises(sa.SceneError, match="elemens"):
        ArmEnv("TendonTracking", random={"rod.elemens": (3, 4)})
    with pytest.raises(ValueError, match="low <= high"):
        ArmEnv("TendonTracking", random={"rod.material.density_kg_m3": (3.0, 2.0)})
    with pytest.raises(ValueError, match="one of the two"):
        ArmVectorEnv("TendonTracking", 2, each={"rod.material.density_kg_m3": [1e3, 1e3]}, random=RANDOM)


@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
def test_random_arms_of_a_vector_are_those_of_single_environments(gymnasium, mode):
    from gymnasium.vector import SyncVectorEnv
    from softarm.gym import ArmEnv, ArmVectorEnv

    own = {"random": RANDOM, "reward": reward_of_effort, "observation": observation_of_error}
    single = SyncVectorEnv([lambda: ArmEnv(Short(), **own)] * 3, autoreset_mode=mode)
    vector = ArmVectorEnv(Short(), 3, autoreset_mode=mode, **own)
    same(vector.reset(seed=1), single.reset(seed=1))
    vector.action_space.seed(1)
    for _ in range(10):
        actions = vector.action_space.sample()
        same(vector.step(actions), single.step(actions))


def test_pictures_show_arm_target_and_obstacles(gymnasium):
    """Pixels where something is differ from those of a picture without it, and nothing is drawn outside of the frame."""
    pytest.importorskip("matplotlib")
    from softarm.gym import ArmEnv, ArmVectorEnv

    class Beside(environments.TendonTracking):
        """An arm beside a ball, with one target."""

        steps = 4
        ball = {"obstacle": [{"sphere": {"center_m": [0.1, 0.1, 0.15], "radius_m": 0.04}}]}

        def __init__(self, target=(0.05, 0.0, 0.24), **changes):
            super().__init__(changes=changes)
            self.target = target

        def path(self, rng):
            return np.tile(self.target, (self.steps + 1, 1))

    def shot(*args, **changes):
        env = ArmEnv(Beside(*args, **changes), render_mode="rgb_array")
        env.reset(seed=0)
        return env, env.render()

    env, plain = shot()
    assert plain.dtype == np.uint8 and plain.shape == (480, 480, 3)
    assert np.array_equal(plain, env.render())
    differs = lambda a, b: np.any(a != b, axis=2).sum()
    assert differs(plain, shot(**{"obstacle.0.sphere": Beside.ball["obstacle"][0]["sphere"]})[1]) > 200
    assert differs(plain, shot((0.05, 0.05, 0.24))[1]) > 50
    env.step(np.full(4, 0.5))
    env.step(np.array([0.5, -0.5, 0.0, 0.0]))
    assert differs(plain, env.render()) > 50
    edge = np.concatenate([plain[[0, -1]].reshape(-1, 3), plain[:, [0, -1]].reshape(-1, 3)])
    assert (edge == 255).all()
    vector = ArmVectorEnv(Beside(), 2, render_mode="rgb_array")
    with pytest.raises(gymnasium.error.ResetNeeded):
        vector.render()
    vector.reset(seed=0)
    assert [np.array_equal(frame, plain) for frame in vector.render()] == [True, True]
    with pytest.raises(ValueError, match="render_mode"):
        ArmEnv("TendonTracking", render_mode="ansi")


def test_a_window_shows_every_action(gymnasium, monkeypatch):
    """On a screen, each for its time; without one the logger says so, and nothing waits."""
    matplotlib = pytest.importorskip("matplotlib")
    matplotlib.use("agg")
    import matplotlib.pyplot as plt

    shown = []
    monkeypatch.setattr(plt, "pause", shown.append)
    for framework in (None, "screen"):
        monkeypatch.setattr("matplotlib.backends.backend_agg.FigureCanvasAgg.required_interactive_framework", framework)
        env = gymnasium.make("softarm/TendonTracking-v0", render_mode="human")
        env.reset(seed=0)
        env.step(env.action_space.sample())
        assert env.render() is None and plt.get_fignums()
        env.close()
        assert not plt.get_fignums()
    assert shown == [1.0 / 15.0] * 2


def test_every_shape_of_an_obstacle_is_drawn():
    """Each surface is where the shape says: points of it are on the boundary."""
    from softarm import pictures

    center, turn = np.array([0.1, 0.2, 0.3]), np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    off = pictures._ball(center, 0.2) - center[:, None, None]
    assert np.allclose(np.linalg.norm(off, axis=0), 0.2)
    begin, end = np.array([0.0, 0.1, 0.0]), np.array([0.3, 0.1, 0.4])
    points = np.moveaxis(pictures._capsule(begin, end, 0.05), 0, 2).reshape(-1, 3)
    part = np.clip((points - begin) @ (end - begin) / 0.25, 0.0, 1.0)
    assert np.allclose(np.linalg.norm(points - begin - part[:, None] * (end - begin), axis=1), 0.05)
    faces = list(pictures._box(center, np.array([0.2, 0.4, 0.6]), [np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)]))
    corners = np.concatenate([np.moveaxis(face, 0, 2).reshape(-1, 3) for face in faces])
    assert len(faces) == 6 and np.allclose(np.abs((corners - center) @ turn), [0.1, 0.2, 0.3])
    normal = np.array([1.0, 2.0, 3.0])
    plane = np.moveaxis(pictures._plane(center, normal, np.zeros(3), np.ones(3)), 0, 2).reshape(-1, 3)
    assert np.allclose((plane - center) @ normal, 0.0) and (plane > -1e-12).all() and (plane < 1 + 1e-12).all()
    assert pictures._plane(np.array([5.0, 0.0, 0.0]), np.array([1.0, 0.0, 0.0]), np.zeros(3), np.ones(3)) is None


def test_radii_of_pictures_are_those_of_the_arm():
    from softarm import pictures

    at = np.array([0.0, 0.25, 0.5, 1.0])
    keys = sa.arm(0.4, 0.01, 1e6) | {"time": {"end_s": 1.0}}
    taper = sa.Scene(keys).replace({"rod.section": {"radius_base_m": 0.02, "radius_tip_m": 0.01}})
    assert np.allclose(pictures.radii(taper, at), 0.02 - 0.01 * at)
    material = keys["rod"]["material"]
    parts = [{"length_m": 0.1, "section": {"diameter_m": 0.03}}, {"length_m": 0.3, "section": {"shape": "rectangle", "width_m": 0.01, "height_m": 0.02}}]
    rod = {"length_m": 0.4, "elements": 8, "material": material, "segment": [{**part, "material": material} for part in parts]}
    assert np.allclose(pictures.radii(sa.Scene({**keys, "rod": rod}), at), [0.015, 0.015, 0.01, 0.01])


@pytest.mark.parametrize("name", ["TendonTracking", "SoftArmTracking", "random"])
def test_a_replayed_episode_is_that_of_the_environment(gymnasium, name):
    """To the byte, for an arm with tendons, one with couples along it, and one with other values in every episode."""
    from softarm.gym import ArmEnv

    class Episode(environments.TASKS.get(name, environments.TendonTracking)):
        steps = 12
        random = RANDOM if name == "random" else {}

    task = Episode()
    policy = lambda seen: np.resize(np.sin(1e3 * seen), len(task.low)) * task.high
    found = policies.replay(policy, task, seeds=[3, 4])
    row = 0
    for seed in (3, 4):
        env = ArmEnv(task)
        seen, over = env.reset(seed=seed)[0], False
        while not over:
            assert np.array_equal(found.observations[row], seen)
            seen, reward, terminated, truncated, info = env.step(policy(seen))
            assert np.array_equal(found.next_observations[row], seen) and found.rewards[row] == reward
            assert found.terminated[row] == terminated and found.truncated[row] == truncated
            assert found.distances[row] == pytest.approx(info["distance_m"], rel=1e-12)
            over, row = terminated or truncated, row + 1
    assert row == len(found.rewards) == 24


def test_a_policy_moves_the_plant_of_another_scene():
    """One with other elements: wrenches keep their sums, and the tip of a finer arm goes nearly where that of the task does."""
    here, there = np.linspace(0.0, 1.0, 11), np.linspace(0.0, 1.0, 24)
    wrenches = np.random.default_rng(0).normal(size=(11, 6))
    moved = policies._moved(wrenches, here, there)
    assert np.allclose(moved.sum(axis=0), wrenches.sum(axis=0))
    assert np.allclose(there @ moved, here @ wrenches)  # moments of the forces about the base, too

    class Episode(environments.SoftArmTracking):
        steps = 20

    task = Episode(target=(0.3, 0.8, 0.0))
    policy = policies.FromState(lambda state, action, target: np.array([0.0, 0.0, 0.0, 0.0, 10.0, 10.0, 10.0, 10.0]))
    coarse = policies.replay(policy, task)
    fine = policies.replay(policy, task, plant=task.scene.replace({"rod.elements": 33}))
    went = np.linalg.norm(coarse.tips[-1] - coarse.tips[0])
    assert went > 0.05 and np.linalg.norm(fine.tips - coarse.tips, axis=1).max() < 0.05 * went
    broken = policies.replay(policy, task, plant=task.scene.replace(BROKEN))
    assert broken.terminated[-1] and broken.rewards[-1] == task.lost and len(broken.rewards) < task.steps
    with pytest.raises(ValueError, match="actuators"):
        policies.replay(policy, task, plant=environments.TendonTracking().scene)
    with pytest.raises(ValueError, match="finite numbers"):
        policies.replay(lambda seen: np.zeros(3), task)


def test_actions_are_efforts_unless_a_task_says_otherwise():
    class Direct(environments.TendonTracking):
        commands = environments.Task.commands

    task = Direct()
    arms = environments.Arms(task, 1)
    arms.reset([0], [np.random.default_rng(0)])
    arms.step(np.array([[0.5, 0.0, 0.25, 0.0]]))
    assert arms.efforts.tolist() == [[0.5, 0.0, 0.25, 0.0]]
    with pytest.raises(NotImplementedError, match="8 actions and 0 actuators"):
        environments.Task.commands(environments.SoftArmTracking(), np.zeros((1, 8)), np.zeros((1, 0)))


def test_scaled_actions_are_parts_of_their_bounds(gymnasium):
    from softarm.gym import ArmEnv, ArmVectorEnv

    env, plain, vector = ArmEnv(Short(), scaled=True), ArmEnv(Short()), ArmVectorEnv(Short(), 2, scaled=True)
    assert env.action_space.high.tolist() == [1.0] * 4 and vector.single_action_space == env.action_space
    env.reset(seed=1), plain.reset(seed=1), vector.reset(seed=1)
    actions = np.array([[1.0, 0.5, -0.25, 3.0]] * 2)
    theirs = plain.step(np.array([0.5, 0.25, -0.125, 0.5]))[0]
    assert np.array_equal(env.step(actions[0])[0], theirs) and np.array_equal(vector.step(actions)[0][0], theirs)
    with pytest.raises(ValueError, match=r"actions\[0, 1\] is nan"):
        env.step(np.array([0.0, np.nan, 0.0, 0.0]))
    with pytest.raises(ValueError, match="shape"):
        env.step(np.zeros(3))


def test_couples_are_those_of_a_cubic():
    """A cubic that is 0 at both ends is its own spline, whatever its points; with one point a parabola is."""
    places = np.linspace(0.0, 1.0, 21)
    cubic = lambda s: s * (1.0 - s) * (0.3 + s)
    for points in (2, 3, 4, 6):
        at = np.linspace(0.0, 1.0, points + 2)[1:-1]
        assert np.abs(environments.couples(places, points) @ cubic(at) - cubic(places)).max() < 1e-12
    assert np.abs(environments.couples(places, 1)[:, 0] - 4.0 * places * (1.0 - places)).max() < 1e-12


def test_small_couples_bend_an_arm_as_in_beam_theory():
    """At rest the tip of ElasticaCase1 is aside by w = 1/EI int m(s) (L s - s^2/2) ds, up to the square of an element's length: at most 3 % with
    forty elements, as the sums of these splines change sign. After 900 actions the slowest mode, of 0.2 s, is down to a percent.
    """
    task = environments.ElasticaCase1(elements=40)
    arms = environments.Arms(task, 1)
    arms.reset([0], [np.random.default_rng(0)])
    action = np.random.default_rng(1).uniform(-50.0, 50.0, 12)
    for _ in range(900):
        arms.step(action[None])
    s = (np.arange(2000) + 0.5) / 2000
    about = [(environments.couples(s, 6) @ part * (s - 0.5 * s**2)).mean() for part in (action[:6], action[6:])]
    axes = task.scene.plant().state.R[0]
    expected = (about[1] * axes[:, 0] - about[0] * axes[:, 1]) / (1e7 * 0.25 * np.pi * 0.05**4)
    off = arms.batch.positions[0, -1] - [0.0, 1.0, 0.0]
    assert np.linalg.norm((off - expected)[[0, 2]]) < 0.03 * np.linalg.norm(expected)


def test_wrenches_of_a_batch_act_on_all_nodes():
    """An arm of a batch under wrenches on its nodes moves like a plant under them; those on tips alone are a case of it."""
    scene = sa.Scene.load("swing")
    plant, arms = scene.plant(), sa.batch(scene, 2)
    wrenches = np.random.default_rng(0).uniform(-0.01, 0.01, (2, len(plant.places), 6))
    plant.step(0.02, wrenches[1])
    assert arms.step(0.02, wrenches) == [None, None] and np.array_equal(arms.positions[1], plant.state.x)
    wrenches[:, :-1] = 0.0
    others = sa.batch(scene, 2)
    arms.reset()
    arms.step(0.02, wrenches)
    others.step(0.02, wrenches[:, -1])
    assert np.array_equal(arms.positions, others.positions)
    with pytest.raises(ValueError, match="shape"):
        arms.step(0.02, wrenches[:, 1:])


def bent(elements, curvatures):
    """A state of an arm along z with these curvatures in x and y (1/m) as functions of arc length, by small rotations."""
    fine, turn = 64, 1.0 / (64 * elements)
    R, x, states = np.eye(3), np.zeros(3), []
    for k in range(fine * elements + 1):
        if k % fine == 0:
            states.append((x.copy(), R.copy()))
        a, b = (curvature((k + 0.5) * turn) * turn for curvature in curvatures)
        angle = np.hypot(a, b) or 1e-300
        K = np.array([[0.0, 0.0, b], [0.0, 0.0, -a], [-b, a, 0.0]]) / angle
        step = np.eye(3) + np.sin(angle) * K + (1.0 - np.cos(angle)) * K @ K
        x, R = x + turn * R[:, 2], R @ step
    x, R = (np.array(own) for own in zip(*states))
    s = np.linspace(0.0, 1.0, elements + 1)[:, None]
    return sa.State(x, R, np.sin(s * [1.0, 2.0, 3.0]), np.cos(s * [3.0, 1.0, 2.0]))


def test_layouts_of_elastica_there_and_back():
    """Exact for arms that are curved alike all along, and of second order for others; positions and velocities are the same numbers."""
    helix = bent(8, (lambda s: 2.0, lambda s: -1.0))
    rod = SimpleNamespace(**elastica.arrays(helix))
    assert rod.position_collection.shape == (3, 9) and rod.director_collection.shape == (3, 3, 8)
    # Directors are rows, and the third points along the arm.
    along = np.diff(rod.position_collection, axis=1)
    assert (np.einsum("in,in->n", rod.director_collection[2], along) > 0.999 * np.linalg.norm(along, axis=0)).all()
    assert np.abs(elastica.state(rod).R - helix.R).max() < 1e-12

    def off(elements):
        own = bent(elements, (lambda s: 3.0 * np.sin(4.0 * s), lambda s: 2.0 * np.cos(3.0 * s)))
        back = elastica.state(SimpleNamespace(**elastica.arrays(own)))
        assert np.array_equal(back.x, own.x) and np.array_equal(back.v, own.v)
        return max(np.abs(back.R - own.R).max(), np.abs(back.w - own.w).max())

    assert off(16) / off(32) == pytest.approx(4.0, rel=0.25)
    assert np.array_equal(elastica.state(rod, 4).x, helix.x[::2])
    with pytest.raises(ValueError, match="divide"):
        elastica.state(rod, 3)


def test_a_rod_of_elastica_takes_a_state():
    ea = pytest.importorskip("elastica")
    keys = sa.arm(1.0, 0.05, 1e6, elements=10, direction=(0.0, 0.0, 1.0), gravity=False) | {"time": {"end_s": 1.0}}
    plant = sa.Scene(keys).plant()
    normal = plant.state.R[0, :, 0]
    rod = ea.CosseratRod.straight_rod(
        10, np.zeros(3), np.array([0.0, 0.0, 1.0]), normal, 1.0, 0.05, 1000.0, youngs_modulus=1e6, shear_modulus=1e6 / 3
    )
    # An arm at rest is the same in both.
    for name, array in elastica.arrays(plant.state).items():
        assert np.abs(getattr(rod, name) - array).max() < 1e-14
    wrenches = np.zeros((11, 6))
    wrenches[-1, 0] = 5.0
    elastica.put(rod, plant.step(0.2, wrenches))
    assert np.array_equal(elastica.state(rod).x, plant.state.x)
    with pytest.raises(ValueError, match="5 elements"):
        elastica.put(rod, sa.State(*(own[::2] for own in plant.state)))


def test_a_rest_is_learned_from_a_chain_of_mujoco():
    """Weights from a few shapes at rest bring a loop nearer to its circle on a chain that bends more easily, and does not stretch."""
    pytest.importorskip("mujoco")
    without, with_rest = runpy.run_path(str(EXAMPLES / "learned_rest.py"))["main"](1.5, 8)
    assert with_rest < 0.7 * without


def test_a_chain_of_mujoco_has_states_and_takes_wrenches():
    """Velocities are differences of poses along the motion, and the power of forces in the chain's coordinates is that of wrenches on nodes."""
    mujoco = pytest.importorskip("mujoco")
    model = runpy.run_path(str(EXAMPLES / "plant_mujoco.py"))["chain"]()
    data, nodes, dice = mujoco.MjData(model), [1, 2, 5, 11], np.random.default_rng(4)
    data.qvel = dice.normal(size=model.nv)
    mujoco.mj_integratePos(model, data.qpos, dice.normal(size=model.nv), 0.3)
    now = chains.state(model, data, nodes)
    later, dt = mujoco.MjData(model), 1e-7
    later.qpos, later.qvel = data.qpos, data.qvel
    mujoco.mj_integratePos(model, later.qpos, later.qvel, dt)
    moved = chains.state(model, later, nodes)
    assert np.abs((moved.x - now.x) / dt - now.v).max() < 1e-5
    turned = np.einsum("nji,njk->nik", now.R, moved.R - now.R) / dt
    assert np.abs(np.stack([turned[:, 2, 1], turned[:, 0, 2], turned[:, 1, 0]], axis=1) - now.w).max() < 1e-5
    assert np.abs(now.w[1:]).min() > 1e-3  # the first body is fixed

    wrenches = {0.0: dice.normal(size=6), 0.7: dice.normal(size=6), 1.0: dice.normal(size=6)}  # on the first, third and last of four
    data.xfrc_applied = dice.normal(size=data.xfrc_applied.shape)
    elsewhere = [body for body in range(model.nbody) if body not in nodes]
    data.xfrc_applied[elsewhere] = 0.0
    chains.act(SimpleNamespace(wrenches_at=lambda time: wrenches), data, nodes)
    # All forces along the coordinates, less those without wrenches.
    mujoco.mj_forward(model, data)
    forces = data.qfrc_smooth.copy()
    at = zip((0, 2, 3), wrenches.values(), strict=True)
    power = sum(wrench[:3] @ now.v[node] + wrench[3:] @ now.w[node] for node, wrench in at)
    chains.act(SimpleNamespace(wrenches_at=lambda time: {}), data, nodes)
    assert not data.xfrc_applied.any()
    mujoco.mj_forward(model, data)
    assert (forces - data.qfrc_smooth) @ data.qvel == pytest.approx(power, rel=1e-9)


def test_stable_baselines_learn_on_many_arms(gymnasium):
    pytest.importorskip("stable_baselines3")
    from stable_baselines3 import PPO
    from stable_baselines3.common.vec_env import VecMonitor

    from softarm.gym import ArmVectorEnv
    from softarm.sb3 import ArmVecEnv

    with pytest.raises(ValueError, match="SAME_STEP"):
        ArmVecEnv(ArmVectorEnv(Short(), 2))
    direct, envs = ArmVectorEnv(Short(), 2, autoreset_mode="SameStep"), ArmVecEnv(ArmVectorEnv(Short(), 2, autoreset_mode="SameStep"))
    envs.seed(3)
    assert np.array_equal(envs.reset(), direct.reset(seed=3)[0])
    for step in range(5):
        seen, rewards, done, infos = envs.step(np.full((2, 4), 0.5))
        theirs = direct.step(np.full((2, 4), 0.25, dtype=np.float32))
        assert np.array_equal(seen, theirs[0]) and np.array_equal(rewards, theirs[1])
        assert done.all() == (step == 3) and all(("terminal_observation" in info) == (step == 3) for info in infos)
        if step == 3:
            assert infos[1]["TimeLimit.truncated"] and np.array_equal(infos[1]["terminal_observation"], theirs[4]["final_obs"][1])
    model = PPO("MlpPolicy", VecMonitor(envs), n_steps=8, batch_size=16, seed=0, device="cpu").learn(32)
    assert model.num_timesteps == 32 and model.ep_info_buffer[0]["l"] == 4


def pull(state, action, target):
    """Pulls the tendons on the side of the target, as far as it is away."""
    x, y, _ = 8.0 * (target.x - state.x[-1]) + 3.0 * (target.v - state.v[-1])
    return np.clip([x, -x, y, -y], -0.5, 0.5)


def test_policies_of_stable_baselines_move_plants(gymnasium, tmp_path):
    """A saved model, with its normalization, does in `replay` what it does in the environments that it learned in."""
    pytest.importorskip("stable_baselines3")
    from stable_baselines3 import PPO
    from stable_baselines3.common.vec_env import VecNormalize

    from softarm.gym import ArmVectorEnv
    from softarm.sb3 import ArmVecEnv, Policy

    def made():
        return ArmVecEnv(ArmVectorEnv(Short(), 2, autoreset_mode="SameStep"))

    learned = VecNormalize(made())
    model = PPO("MlpPolicy", learned, n_steps=8, batch_size=16, seed=0, device="cpu").learn(32)
    model.save(tmp_path / "model"), learned.save(str(tmp_path / "normalize"))
    model = PPO.load(tmp_path / "model", device="cpu")
    normalize = VecNormalize.load(str(tmp_path / "normalize"), made())
    normalize.training = normalize.norm_reward = False
    policy = Policy(model, Short(), normalize=normalize)
    normalize.seed(7)
    seen = normalize.reset()
    found = policies.replay(policy, Short(), seeds=[7, 8])
    assert found.actions.max() > 0.01  # it does act
    for step in range(4):
        seen, rewards, _, infos = normalize.step(model.predict(seen, deterministic=True)[0])
        # One row at a time, a network of single precision has other roundings.
        assert np.allclose(rewards, found.rewards[[step, 4 + step]], rtol=1e-4)
        assert np.allclose([info["distance_m"] for info in infos], found.distances[[step, 4 + step]], rtol=1e-4)
    with pytest.raises(ValueError, match="shape"):
        Policy(model, environments.SoftArmTracking())
    with pytest.raises(ValueError, match="observations"):
        Policy(model, Short().replaced(observation=observation_of_error))
    # A model whose actions are of other units does not move an arm as if they were not.
    with pytest.raises(ValueError, match="softarm.sb3.Policy"):
        policies.replay(model, Short())
    plain = PPO("MlpPolicy", ArmVecEnv(ArmVectorEnv(Short(), 2, autoreset_mode="SameStep"), scaled=False), n_steps=8, batch_size=16, device="cpu")
    same(policies.replay(plain, Short()), policies.replay(Policy(plain, Short()), Short()))


def test_experts_act_for_stable_baselines(gymnasium):
    """`evaluate_policy` runs an expert on many arms, and a replay buffer has what it did, as the algorithm itself would have put it there."""
    pytest.importorskip("stable_baselines3")
    from stable_baselines3 import SAC
    from stable_baselines3.common.evaluation import evaluate_policy
    from stable_baselines3.common.vec_env import VecMonitor, VecNormalize

    from softarm.gym import ArmVectorEnv
    from softarm.sb3 import ArmVecEnv, Expert, fill

    task = Short()
    envs = VecMonitor(ArmVecEnv(ArmVectorEnv(task, 2, autoreset_mode="SameStep")))
    envs.seed(7)
    returns, _ = evaluate_policy(Expert(envs, pull), envs, n_eval_episodes=2, return_episode_rewards=True)
    found = policies.replay(policies.FromState(pull), task, seeds=[7, 8])
    # VecMonitor keeps returns in single precision.
    assert np.allclose(sorted(returns), sorted(found.rewards.reshape(2, 4).sum(axis=1)), rtol=1e-5)
    assert Expert(envs, [pull, pull]).predict(None)[0].shape == (2, 4)
    with pytest.raises(ValueError, match="each of the 2 arms"):
        Expert(envs, [pull])
    with pytest.raises(TypeError, match="ArmVecEnv"):
        Expert(object(), pull)

    model = SAC("MlpPolicy", envs, buffer_size=64, learning_starts=0, batch_size=8, seed=0, device="cpu")
    assert fill(model.replay_buffer, found, task) == 8 and model.replay_buffer.size() == 4
    buffer = model.replay_buffer
    assert np.array_equal(buffer.observations[:4].reshape(8, -1), found.observations)
    assert np.allclose(buffer.actions[:4].reshape(8, -1), found.actions / 0.5)
    assert buffer.dones[:4].ravel().tolist() == buffer.timeouts[:4].ravel().tolist() == [0.0, 0.0, 0.0, 1.0] * 2
    model._setup_learn(8)
    model.train(gradient_steps=2, batch_size=8)


def test_vectors_of_stable_baselines_are_copied_drawn_and_told(gymnasium):
    pytest.importorskip("stable_baselines3")
    pytest.importorskip("matplotlib")
    from softarm.gym import ArmVectorEnv
    from softarm.sb3 import ArmVecEnv

    envs = ArmVecEnv(ArmVectorEnv(Short(), 2, autoreset_mode="SameStep", render_mode="rgb_array", random=RANDOM))
    envs.seed(3)
    envs.reset()
    assert envs.reset_infos[1]["parameters"].keys() == RANDOM.keys()
    envs.step(np.full((2, 4), 0.5))
    assert envs.render().shape[2] == 3 and len(envs.get_images()) == 2
    for other in (copy.deepcopy(envs), pickle.loads(pickle.dumps(envs))):
        other.step(np.full((2, 4), 0.5))
        assert other.envs.arms.taken.tolist() == [2, 2] and envs.envs.arms.taken.tolist() == [1, 1]


def test_the_example_of_learning_runs(tmp_path):
    pytest.importorskip("stable_baselines3")
    pytest.importorskip("matplotlib")
    example = runpy.run_path(str(EXAMPLES / "learn_tendon_tracking.py"))
    means = example["main"](64, tmp_path / "curve.png")
    assert np.isfinite(list(means.values())).all() and (tmp_path / "curve.png").stat().st_size > 0


def test_the_example_of_gradients_runs(tmp_path):
    pytest.importorskip("stable_baselines3")
    pytest.importorskip("matplotlib")
    example = runpy.run_path(str(EXAMPLES / "learn_by_gradient.py"))
    clocks = example["main"](840, 64, tmp_path / "curve.png")
    assert all(np.isfinite(mean) for clock in clocks for _, _, mean in clock.rows) and (tmp_path / "curve.png").stat().st_size > 0


@pytest.fixture(scope="module")
def cases():
    return SimpleNamespace(**runpy.run_path(str(EXAMPLES / "elastica_cases.py")))


def test_rewards_of_the_cases_of_elastica(cases):
    """Against values by hand, and the quaternion of the scene against the axes of the section that it stands for."""
    episode = cases.Episode(2, np.random.default_rng(1))
    assert (episode.target >= [-0.6, 0.3, -0.6]).all() and (episode.target <= [0.6, 0.9, 0.6]).all()
    episode.aim(0.3)
    w, x, y, z = ast.literal_eval(episode.overrides[1].split("=")[1])[0][1:]
    axes = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    assert np.allclose(axes, episode.turned, atol=1e-12)

    def reward(distance, angle):
        turn = np.array([[np.cos(angle), 0.0, np.sin(angle)], [0.0, 1.0, 0.0], [-np.sin(angle), 0.0, np.cos(angle)]])
        return episode.rewards(episode.target[None] + [[distance, 0.0, 0.0]], (turn @ episode.turned)[None])[0]

    half = np.sin(0.5) ** 2  # 0.23, of an angle of 1 rad
    assert np.isclose(reward(0.0, 0.0), 6.0)
    assert np.isclose(reward(0.04, 1.0), -0.0016 - 0.5 * half**2 + 2.0 * (2.0 - half))
    assert np.isclose(reward(0.08, 0.0), -0.0064 + 1.5)
    assert np.isclose(reward(0.5, 1.0), -0.25 - 0.5 * half**2)
    for case in (3, 4):
        episode = cases.Episode(case, None)
        tips = episode.target + np.array([[0.04, 0.0, 0.0], [0.0, 0.08, 0.0], [0.0, 0.0, 0.5]])
        assert np.allclose(episode.rewards(tips, None), [2.0 - 0.0016, 0.5 - 0.0064, -0.25])


@pytest.mark.parametrize(("case", "by_s"), [(2, 0.2), (4, 0.6)])
def test_targets_of_the_cases_of_elastica_are_reached(cases, case, by_s):
    """From then on the tip stays within the 5 cm that are rewarded."""
    episode = cases.Episode(case, np.random.default_rng(0))
    tips, _ = cases.in_softarm(episode, round((by_s + 0.1) / cases.ACTION))
    late = tips[round(by_s / cases.ACTION) :] - episode.target
    assert np.linalg.norm(late, axis=1).max() < 0.05


def test_a_rod_of_elastica_obeys_the_loop(cases):
    pytest.importorskip("elastica")
    episode = cases.Episode(2, np.random.default_rng(0))
    tips, rotations = cases.in_elastica(episode, 210)
    assert episode.rewards(tips, rotations)[-70:].mean() > 3.0  # within 5 cm, and turned


@pytest.mark.parametrize(("package", "name"), [("elastica", "pyelastica"), ("mujoco", "mujoco")])
def test_plants_of_other_packages_are_held_on_the_circle(package, name):
    """The example asserts less than 1 % of the length, after the first turn of two seconds."""
    pytest.importorskip(package)
    runpy.run_path(str(EXAMPLES / f"plant_{name}.py"))["main"](3.0)


@pytest.mark.parametrize("package", ["joblib", "dask", "ray"])
def test_sweeps_with_two_workers(package, tmp_path, monkeypatch):
    pytest.importorskip(package)
    if package == "dask":
        pytest.importorskip("distributed")
    monkeypatch.chdir(tmp_path)
    done = subprocess.run([sys.executable, EXAMPLES / f"sweep_{package}.py"], capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("tip at") == 4
