"""Motions under sequences of controls, and their derivatives against differences of whole motions."""

import pickle
import runpy
import warnings
from pathlib import Path

import numpy as np
import pytest

import softarm as sa

KEYS = ["rod.material.youngs_modulus_pa", "rod.material.density_kg_m3", "tendon.0.offset_m.0", "damping.viscous_1_s", "load.0.force_n.1"]
TENDONS = {
    "tendon": [{"name": "left", "offset_m": [0.008, 0.0]}, {"name": "front", "offset_m": [0.0, 0.008]}],
    "damping": {"viscous_1_s": 1.0},
    "load": [{"node": "tip", "force_n": [0.0, 0.0, 0.0]}],
    "time": {"end_s": 1.0},
}


def scene(**more):
    return sa.Scene(sa.arm(0.3, 0.01, 1e5, elements=6) | TENDONS | more)


def efforts(n=10):
    return 0.2 + 0.1 * np.random.default_rng(1).random((n, 2))


def differences(of, at, index, size):
    """Central differences of fourth order."""

    def central(step):
        ahead, behind = at.copy(), at.copy()
        ahead[index] += step
        behind[index] -= step
        return (of(ahead) - of(behind)) / (2 * step)

    return (4 * central(0.5e-3 * size) - central(1e-3 * size)) / 3


def weights(motion, seed=3):
    dice = np.random.default_rng(seed)
    return {name: dice.standard_normal(getattr(motion, name).shape) * size for name, size in [("x", 1), ("R", 0.1), ("v", 0.1), ("w", 1e-3)]}


def total(motion, along):
    return sum(np.sum(own * getattr(motion, name)) for name, own in along.items())


@pytest.mark.parametrize("linear", [False, True])
def test_derivatives_are_those_of_whole_motions(linear):
    rollout = scene().rollout(0.02, KEYS, linear=linear, nodes=[3, -1])
    assert rollout.actuators == ["left", "front"] and np.array_equal(rollout.values[1:3], [1000.0, 0.008])
    own, values = efforts(), rollout.values
    wrenches = np.random.default_rng(2).standard_normal((10, 2, 6)) * [0.01, 0.01, 0.01, 1e-4, 1e-4, 1e-4]
    start = rollout(own, wrenches=wrenches).end
    motion = rollout(own, wrenches=wrenches, start=start)
    assert motion.x.shape == (10 if linear else 11, 7, 3) and np.array_equal(motion.x[0], start.x)
    along = weights(motion)
    found = motion.gradient(**along)

    def value(efforts=own, wrenches=wrenches, values=values, start=start):
        return total(rollout(efforts, wrenches=wrenches, values=values, start=start), along)

    def near(slope, expected, scale):
        assert abs(slope - expected) < 1e-6 * (abs(expected) + scale), (slope, expected)

    for i, size in enumerate([1e5, 1000.0, 0.008, 1.0, 0.1]):
        near(found.values[i], differences(lambda x: value(values=x), values, i, size), 0.1 / size)
    for at in [(0, 0), (4, 1), (9, 0)]:
        near(found.efforts[at], differences(lambda x: value(efforts=x), own, at, 0.1), 1.0)
        at, size = (at[0], at[1], 1), 0.01
        near(found.wrenches[at], differences(lambda x: value(wrenches=x), wrenches, at, size), 1.0)
    for part, at, size in [("x", (4, 0), 1e-3), ("v", (6, 1), 0.1), ("w", (2, 2), 1.0)]:
        of = lambda x: value(start=start._replace(**{part: x}))
        near(getattr(found.start, part)[at], differences(of, getattr(start, part), at, size), 1.0)
    # Along a turn of a section.
    hat = np.array([[0.0, -0.3, 0.2], [0.3, 0.0, -0.5], [-0.2, 0.5, 0.0]])
    angles = np.zeros(1)

    def turned(angle):
        R = start.R.copy()
        R[4] = R[4] @ (np.eye(3) + angle[0] * hat + 0.5 * angle[0] ** 2 * hat @ hat)
        return value(start=start._replace(R=R))

    near(np.sum(found.start.R[4] * (start.R[4] @ hat)), differences(turned, angles, 0, 0.05), 1.0)


@pytest.mark.parametrize("integrator", ["explicit", "implicit"])
def test_learned_rests_have_derivatives(integrator):
    """Weights of a rest of the arm and of one of a tendon are numbers as others, and a rest has no effort of its own."""
    section = {"strains": ["bend_1", "bend_2"], "grid": [[-6.0, 6.0, 3]] * 2, "weights": [1e-4 * k for k in range(9)]}
    tendon = {"of": ["left"], "strains": ["toward"], "grid": [[-10.0, 10.0, 3]], "weights": [1e-3, 2e-3, 1e-3]}
    arm = scene(learned=[section, tendon], time={"end_s": 1.0, "integrator": integrator})
    keys = ["learned.0.weights.4", "learned.1.weights.1", KEYS[0]]
    rollout, own = arm.rollout(0.02, keys), efforts()
    assert rollout.actuators == ["left", "front"] == arm.plant().actuators
    motion = rollout(own)
    along = weights(motion)
    found = motion.gradient(**along)
    for i, size in enumerate([1e-3, 1e-3, 4e4]):
        expected = differences(lambda x: total(rollout(own, values=x), along), rollout.values, i, size)
        assert abs(found.values[i] - expected) < 1e-6 * (abs(expected) + 0.1 / size)
    expected = differences(lambda x: total(rollout(x), along), own, (3, 0), 0.1)
    assert abs(found.efforts[3, 0] - expected) < 1e-6 * (abs(expected) + 1.0)
    rows = [[0.3, 0.1]]
    shapes = arm.shapes(rows, gradient=keys)
    for i, (key, size) in enumerate(zip(keys, [1e-3, 1e-3, 1e5])):
        at = np.array([rollout.values[i]])
        expected = differences(lambda x: arm.replace({key: x[0]}).shapes(rows).x, at, 0, size)
        assert np.abs(shapes.along[0][:, i] - expected).max() < 1e-6 * np.abs(expected).max()


def test_a_rollout_is_the_motion_of_a_plant():
    own = efforts()
    motion, plant = scene().rollout(0.02)(own), scene().plant()
    for k, row in enumerate(own):
        plant.step(0.02, efforts=row)
        assert np.array_equal(plant.tip, motion.tip[k + 1])
    assert np.array_equal(plant.state.R, motion.end.R)


def test_batches_are_their_rows():
    rollout = scene().rollout(0.02, KEYS[:1])
    rows = np.stack([efforts(), 2 * efforts(), 0.5 * efforts()])
    values = np.array([[1e5], [1.2e5], [0.9e5]])
    batch = rollout(rows, values=values)
    along = 2 * batch.tip
    slopes = batch.gradient(tip=along)
    for i in range(3):
        one = rollout(rows[i], values=values[i], threads=1)
        assert np.array_equal(one.x, batch.x[i])
        own = one.gradient(tip=along[i], threads=1)
        assert np.array_equal(own.efforts, slopes.efforts[i]) and np.array_equal(own.values, slopes.values[i])
    assert rollout(values=values, intervals=4).x.shape == (3, 5, 7, 3)
    assert np.array_equal(pickle.loads(pickle.dumps(rollout))(rows).x, rollout(rows).x)


def test_mistakes_are_refused():
    rollout = scene().rollout(0.02, KEYS[:1])
    with pytest.raises(sa.SceneError, match="has no number"):
        scene().rollout(0.02, ["rod.length"])
    with pytest.raises(sa.SceneError, match="changes nothing"):
        bounded = scene(control={"force_max_n": 1.0})
        bounded.rollout(0.02, ["control.force_max_n"])(efforts()).gradient(tip=np.ones((11, 3)))
    with pytest.raises(ValueError, match="number of intervals"):
        rollout()
    with pytest.raises(ValueError, match="shape"):
        rollout(np.ones((4, 3)))
    with pytest.raises(ValueError, match="finite"):
        rollout(np.full((4, 2), np.nan))
    with pytest.raises(ValueError, match="expected"):
        rollout(efforts()).gradient(x=np.ones((2, 2)))
    with pytest.raises(ValueError, match="batches"):
        rollout(np.ones((2, 4, 2)), values=np.ones((3, 1)))
    with pytest.raises(ValueError, match="node 9"):
        scene().rollout(0.02, nodes=[9])
    with pytest.raises(sa.ModelError, match="row 0, interval"):
        rollout(np.full((50, 2), 1e4))


def test_shapes_have_derivatives_along_numbers():
    arm, rows = scene(), [[0.3, 0.1], [0.1, 0.4]]
    keys = [KEYS[0], KEYS[2], KEYS[4], "rod.section.radius_m"]
    found = arm.shapes(rows, gradient=keys)
    assert found.along[0].shape == (2, 4, 7, 3) == found.along[1].shape
    for i, (key, size) in enumerate(zip(keys, [1e5, 0.008, 0.1, 0.01])):
        at = np.array([arm.rollout(0.02, [key]).values[0]])
        expected = differences(lambda x: arm.replace({key: x[0]}).shapes(rows).x, at, 0, size)
        assert np.abs(found.along[0][:, i] - expected).max() < 1e-6 * np.abs(expected).max()


def test_numbers_at_the_end_of_their_range_have_a_derivative():
    """An arm without damping, which cannot be negative; and the shapes of a scene with a loop are those of its model, not of its plant."""
    arm = scene().replace({"damping.viscous_1_s": 0.0})
    motion = arm.rollout(0.02, KEYS[3:4])(efforts())
    found = motion.gradient(tip=np.ones_like(motion.tip)).values[0]

    def of(value):
        return arm.replace({KEYS[3]: value}).rollout(0.02)(efforts()).tip.sum()

    step = 1e-3
    expected = (-3 * of(0.0) + 4 * of(step) - of(2 * step)) / (2 * step)
    assert abs(found - expected) < 1e-5 * abs(expected)
    looped, key = sa.Scene.load("mpc-tendons"), ["rod.material.youngs_modulus_pa"]
    pulls = [[0.3] + [0.1] * (len(looped.inputs) - 1)]
    found = looped.shapes(pulls, gradient=key).along[0][0, 0]
    value = looped[key[0]]
    two = [looped.replace({key[0]: value * (1 + step)}).shapes(pulls).x[0] for step in (1e-4, -1e-4)]
    assert np.allclose(found, (two[0] - two[1]) / (2e-4 * value), rtol=1e-5, atol=1e-6 * np.abs(found).max())


def test_torch_and_jax_have_the_same_derivatives():
    torch = pytest.importorskip("torch")
    rollout, own = scene().rollout(0.02, KEYS[:3]), efforts()
    plain = rollout(own)
    expected = plain.gradient(tip=2 * plain.tip)
    given = [torch.tensor(own, requires_grad=True), torch.tensor(rollout.values, requires_grad=True)]
    x = rollout.to_torch()(given[0], values=given[1])[0]
    (x[:, -1] ** 2).sum().backward()
    assert np.allclose(given[0].grad, expected.efforts, rtol=1e-12) and np.allclose(given[1].grad, expected.values, rtol=1e-12)
    # Through a chain of motions, each from the end of the one before.
    given = torch.tensor(own, requires_grad=True)
    function, state = rollout.to_torch(), None
    for row in given:
        parts = function(row[None], start=state)
        state = [part[-1] for part in parts]
    (state[0][-1] ** 2).sum().backward()
    last = np.zeros_like(plain.tip)
    last[-1] = 2 * plain.tip[-1]
    assert np.allclose(given.grad, plain.gradient(tip=last).efforts, rtol=1e-9)
    jax = pytest.importorskip("jax")
    jax.config.update("jax_enable_x64", True)
    function = rollout.to_jax()
    slopes = jax.jit(jax.grad(lambda efforts, values: (function(efforts, values)[0][:, -1] ** 2).sum(), argnums=(0, 1)))(own, rollout.values)
    assert np.allclose(slopes[0], expected.efforts, rtol=1e-12) and np.allclose(slopes[1], expected.values, rtol=1e-12)
    rows = np.stack([own, 2 * own])
    many = jax.vmap(jax.grad(lambda efforts: (function(efforts, rollout.values)[0][:, -1] ** 2).sum()))(rows)
    assert np.allclose(many[0], expected.efforts, rtol=1e-12)
    # Two axes of batches, numbers that all of them share, a start and wrenches.
    rollout = scene().rollout(0.02, KEYS[:1], nodes=[-1])
    function, state = rollout.to_jax(), plain.end
    pulls = np.full((len(own), 1, 6), 1e-3)

    def total(efforts, values, wrenches, x):
        return (function(efforts, values, wrenches=wrenches, start=state._replace(x=x))[0][..., -1, :] ** 2).sum()

    batch = np.stack([[own, 0.5 * own, 0.2 * own]] * 2)
    slopes = jax.grad(total, argnums=(0, 1, 2, 3))(batch, rollout.values, pulls, state.x)
    motion = rollout(batch.reshape((-1, *own.shape)), wrenches=pulls, start=state)
    expected = motion.gradient(tip=2 * motion.tip)
    assert np.allclose(slopes[0], expected.efforts.reshape(batch.shape), rtol=1e-12)
    assert np.allclose(slopes[1], expected.values.sum(axis=0), rtol=1e-12)
    assert np.allclose(slopes[2], expected.wrenches.sum(axis=0), rtol=1e-12) and np.allclose(slopes[3], expected.start.x.sum(axis=0), rtol=1e-12)
    mapped = jax.vmap(jax.vmap(jax.grad(lambda efforts: total(efforts, rollout.values, pulls, state.x))))(batch)
    assert np.allclose(mapped, slopes[0], rtol=1e-12)


def test_a_step_of_a_plant_has_derivatives():
    """They are those of the rollout of one interval, along the state before too; the plant moves as without."""
    arm, own = scene(), efforts()
    key = KEYS[0]
    plants = [arm.plant() for _ in range(2)]
    for plant in plants:
        plant.step(0.03, None, own[0])
    motion = plants[0].step(0.02, None, own[1], efforts_to=own[2], derivative=[key])
    assert np.array_equal(plants[1].step(0.02, None, own[1], efforts_to=own[2]).x, plants[0].state.x)
    assert np.abs(motion.end.x - plants[0].state.x).max() < 1e-12
    found = motion.gradient(tip=[[0.0] * 3, [1.0, -2.0, 0.5]])

    def tip(change):
        changed = arm.replace({key: arm[key] + change}).plant()
        state = before.state
        changed.set_state(state)
        return changed.step(0.02, None, own[1], efforts_to=own[2]).x[-1] @ [1.0, -2.0, 0.5]

    before = arm.plant()
    before.step(0.03, None, own[0])
    width = 1e-4 * arm[key]
    assert found.values[0] == pytest.approx((tip(width) - tip(-width)) / (2 * width), rel=1e-5)
    assert found.efforts.shape == (2, len(arm.inputs)) and np.abs(found.start.v).max() > 0.0


def test_second_derivatives_of_motions_are_refused():
    torch = pytest.importorskip("torch")
    function = scene().rollout(0.02).to_torch()
    with pytest.raises(RuntimeError, match="second derivatives"):
        torch.autograd.functional.hessian(lambda own: (function(own)[0][-1, -1] ** 2).sum(), torch.tensor(efforts()))


def test_an_arm_is_designed(capsys, monkeypatch):
    pytest.importorskip("scipy")
    program = runpy.run_path(str(Path(__file__).parents[2] / "examples" / "codesign.py"))
    design, own, found = program["optimum"](np.array([0.009, 0.005, 0.005]))
    assert found.success and own.gives < 1.0001 * program["GIVES"]
    # No neighbour that keeps the limits is better.
    for i in range(3):
        for change in (-2e-5, 2e-5):
            other = program["Design"]()
            at = design + change * np.eye(3)[i]
            other.evaluate(at)
            kept = other.gives <= program["GIVES"] and at[2] <= at[0] - program["WALL"] and (at <= program["BOUNDS"][:, 1]).all()
            assert not kept or other.tensions.max() > own.tensions.max() - 1e-6
    monkeypatch.setattr("sys.argv", ["codesign.py"])
    program["main"]()
    assert "20 of 20 shapes are stable" in (said := capsys.readouterr().out) and "certified" in said


def test_a_rollout_says_once_that_efforts_are_beyond_bounds():
    """The motion is that of the efforts as they are, so that a descent may pass beyond bounds."""
    rollout = scene().rollout(0.02)
    with pytest.warns(UserWarning, match=r'row 3: "front" has -0.2 N, and cannot push'):
        pushed = rollout(np.where(np.arange(10)[:, None] == [[9, 3]], -0.2, efforts()))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert not np.array_equal(rollout(np.full((10, 2), -0.1)).x, pushed.x)
        scene().rollout(0.02)(efforts())
