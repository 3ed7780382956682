"""Environments, their adapters and the examples of other packages; each test is left out where its package is absent."""

import ast
import pickle
import runpy
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import softarm as sa
from softarm import elastica, environments
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
    words = "import softarm, softarm.environments, softarm.elastica, softarm.mujoco, sys; sys.exit(bool({'gymnasium', 'mujoco'} & set(sys.modules)))"
    assert subprocess.run([sys.executable, "-c", words]).returncode == 0


@pytest.mark.filterwarnings("ignore::UserWarning")  # observations have no bounds
@pytest.mark.parametrize("name", NAMES)
def test_environments_keep_the_rules_of_gymnasium(gymnasium, name):
    from gymnasium.utils.env_checker import check_env

    env = gymnasium.make(f"softarm/{name}-v0")
    check_env(env.unwrapped)
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


def test_the_example_of_learning_runs(tmp_path):
    pytest.importorskip("stable_baselines3")
    pytest.importorskip("matplotlib")
    example = runpy.run_path(str(EXAMPLES / "learn_tendon_tracking.py"))
    means = example["main"](64, tmp_path / "curve.png")
    assert np.isfinite(list(means.values())).all() and (tmp_path / "curve.png").stat().st_size > 0


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
