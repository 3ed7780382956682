"""Shapes at rest under many inputs, and fits of tables of commands."""

import numpy as np
import pytest

import softarm as sa

TENDONS = {"time": {"end_s": 1.0}, "tendon": [{"name": "left", "offset_m": [0.008, 0.0]}, {"name": "front", "offset_m": [0.0, 0.008]}]}


def scene(**more):
    return sa.Scene(sa.arm(0.3, 0.01, 1e5, elements=8) | TENDONS | more)


def test_shapes_are_equilibria_and_their_slopes_differences():
    arm = scene()
    assert arm.inputs == [("left", "N"), ("front", "N")]
    angle = np.linspace(0, 2 * np.pi, 50, endpoint=False)
    tensions = 0.3 * np.stack([1 + np.cos(angle), 1 + np.sin(angle)], axis=1)
    found = arm.shapes(tensions, jacobian=True, stability=True)
    assert found.x.shape == (50, 9, 3) and found.R.shape == (50, 9, 3, 3)
    assert found.jacobian.shape == (50, 3, 2) and found.stable.all()
    # The verb for statics refines its elements no further, and finds the same shape.
    row = 17
    keys = {f"tendon.{i}.pretension_n": float(tensions[row, i]) for i in range(2)}
    shape = arm.replace(keys).equilibrium(points=2)
    assert np.abs(shape.x[-1] - found.x[row]).max() < 1e-9
    for i in range(2):
        step = np.zeros(2)
        step[i] = 1e-4
        two = arm.shapes([tensions[row] + step, tensions[row] - step]).tips
        assert np.allclose((two[0] - two[1]) / 2e-4, found.jacobian[row, :, i], rtol=1e-5, atol=1e-9)
    again = arm.shapes({"left": tensions[:, 0], "front": tensions[:, 1]}, threads=1)
    assert np.array_equal(again.x, found.x)
    one = arm.shapes({"front": 0.2})
    assert one.tips.shape == (1, 3) and one.jacobian is None and one.stable is None


def test_equilibria_have_gradients():
    """A straight arm under its tip load: the tip sinks as that of the linear rod, and a number that jumps has no derivative."""
    arm = sa.Scene(sa.arm(0.3, 0.01, 1e5, elements=8, gravity=False) | {"time": {"end_s": 1.0}, "load": [{"node": "tip", "force_n": [1e-6, 0.0, 0.0]}]})
    found = arm.equilibrium(points=2, gradient=["load.0.force_n.0", "base.position_m.1"])
    stiffness = 1e5 * np.pi / 4 * 0.01**4
    assert found.along[0][0, -1, 0] == pytest.approx(0.3**3 / (3 * stiffness), rel=5e-3)
    assert np.allclose(found.along[0][1], [0.0, 1.0, 0.0], atol=1e-9)
    with pytest.raises(ValueError, match="whole loads"):
        arm.equilibrium(points=2, time=0.5, gradient=["load.0.force_n.0"])
    with pytest.raises(sa.SceneError, match="turns the arm at once"):
        arm.shapes(gradient=["base.direction.0"])  # it points along -z


def test_shapes_that_nothing_holds_have_no_gradient():
    """A round arm that buckled under twice Euler's load may turn about the load; a little below that load it has a derivative."""
    stiffness = 1e5 * np.pi / 4 * 0.01**4
    euler = np.pi**2 * stiffness / (4 * 0.3**2)
    straight = sa.arm(0.3, 0.01, 1e5, elements=8, gravity=False, direction=(0.0, 0.0, 1.0))
    arm = sa.Scene(straight | {"time": {"end_s": 1.0}, "load": [{"node": "tip", "force_n": [0.0, 0.0, 0.0]}]})
    key = "load.0.force_n.2"
    below, above = (arm.shapes(changes={key: part * -euler}, gradient=[key]) for part in (0.9, 2.0))
    assert np.isfinite(below.along[0]).all() and np.abs(below.tips[0, :2]).max() < 1e-9
    assert np.isnan(above.along[0]).all() and np.abs(above.tips[0, :2]).max() > 0.1


def test_columns_of_keys_are_those_of_scenes():
    arm = scene(load=[{"node": "tip", "force_n": [0.0, 0.0, 0.0]}])
    moduli, forces = np.linspace(8e4, 2e5, 30), np.linspace(0.0, 0.02, 30)
    changes = {"rod.material.youngs_modulus_pa": moduli, "load.0.force_n.1": forces}
    found = arm.shapes([[0.3, 0.1]], changes=changes, jacobian=True)
    assert found.x.shape == (30, 9, 3) and found.jacobian.shape == (30, 3, 2)
    for row in (0, 13, 29):
        one = arm.replace({key: float(column[row]) for key, column in changes.items()}).shapes([[0.3, 0.1]], jacobian=True)
        assert np.abs(one.x[0] - found.x[row]).max() < 1e-9
        assert np.allclose(one.jacobian[0], found.jacobian[row], rtol=1e-6)
    # Inputs of the scene, and an arm without any.
    held = arm.replace({"tendon.0.pretension_n": 0.2}).shapes(changes={"load.0.force_n.1": forces})
    assert np.abs(held.x[0] - arm.shapes([[0.2, 0.0]]).x[0]).max() < 1e-9
    bare = sa.Scene(sa.arm(0.3, 0.01, 1e5, elements=8) | {"time": {"end_s": 1.0}, "load": [{"node": "tip", "force_n": [0.0, 0.0, 0.0]}]})
    assert bare.shapes(changes={"load.0.force_n.0": [0.0, 0.01]}).tips[1, 0] > 1e-3
    with pytest.raises(ValueError, match="30 rows"):
        arm.shapes(np.zeros((30, 2)), changes={"load.0.force_n.1": [0.0, 1.0]})
    with pytest.raises(sa.SceneError, match="youngs_modulus_pa"):
        arm.shapes(changes={"rod.material.youngs_modulus_pa": [1e5, -1.0]})


def test_inputs_that_do_not_fit_are_refused():
    arm = scene()
    with pytest.raises(ValueError, match=r"inputs has the shape \[4, 3\]; expected \[4, 2\]"):
        arm.shapes(np.zeros((4, 3)))
    with pytest.raises(ValueError, match="not_here"):
        arm.shapes({"not_here": [0.0]})
    with pytest.raises(ValueError, match="finite"):
        arm.shapes([[0.0, np.nan]])
    with pytest.raises(ValueError, match="no actuator"):
        sa.Scene(sa.arm(0.3, 0.01, 1e5, elements=8) | {"time": {"end_s": 1.0}}).shapes(np.zeros((1, 0)))


@pytest.mark.parametrize("play", [0.0, 0.04])
def test_a_table_of_shapes_is_fitted(play):
    arm = scene()
    truth = arm.replace({"rod.material.youngs_modulus_pa": 1.3e5})
    tensions = np.random.default_rng(2).uniform(0.05, 0.5, (40, 2))
    tips = truth.shapes(sa.follow_with_play(tensions, play)).tips
    columns = {"l": tensions[:, 0], "f": tensions[:, 1]} | dict(zip("xyz", tips.T))
    inputs = {name: {"key": f"tendon.{i}.pretension_n", "play": play} for i, name in enumerate("lf")}
    data = {
        "sigma_m": 1e-4,
        "marker": [{"name": "tip", "at": 1.0}],
        "table": [{"csv": columns, "inputs": inputs, "positions": {"tip": {"columns": ["x", "y", "z"]}}}],
    }
    result = arm.fit(data, free=["rod.material.youngs_modulus_pa"])
    assert abs(result.summary["parameters"][0]["value"] / 1.3e5 - 1) < 1e-6


def test_actuators_with_play_lag_behind_commands_that_turn_back():
    """Under a sawtooth an actuator is the play behind on both of its ways, and rests for twice the play where it turns back."""
    up, play = np.arange(0.0, 1.05, 0.1), 0.15
    commands = np.concatenate([up, up[-2::-1]])
    acting = sa.follow_with_play(commands, play)
    assert np.allclose(acting[: len(up)], np.maximum(up - play, 0.0))
    assert np.allclose(acting[len(up) - 1 :], np.minimum(up[-1] - play, commands[len(up) - 1 :] + play))
    both = sa.follow_with_play(np.stack([commands, commands], axis=1), [play, 0.0])
    assert np.array_equal(both[:, 0], acting) and np.array_equal(both[:, 1], commands)
    with pytest.raises(ValueError, match="at least 0"):
        sa.follow_with_play(commands, -0.1)
