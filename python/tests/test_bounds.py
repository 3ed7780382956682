"""Efforts that plants, batches and shapes at rest take from a program."""

import numpy as np
import pytest

import softarm as sa

PAIR_AND_WINCH = sa.arm(0.3, 0.006, 1e6, elements=6) | {
    "tendon": [
        {"name": "a", "offset_m": [0.005, 0.0], "tension_n": [0.0, 3.0], "pretension_n": 0.5},
        {"name": "b", "offset_m": [-0.005, 0.0], "tension_n": [0.0, 3.0], "pretension_n": 0.5, "follows": {"name": "a", "gain": -1.0}},
        {"name": "w", "offset_m": [0.0, 0.005], "displacement_m": [-0.02, 0.01], "compliance_1_n": 1e-3, "free_length_m": 0.1},
    ],
    "time": {"end_s": 0.5, "integrator": "implicit"},
}


@pytest.mark.parametrize(
    "efforts, words",
    [
        ([5.0, -4.0, 0.0], r"\"a\" has 5 N, beyond its bounds, \[0, 3\] N of tendon.0.tension_n"),
        ([-1.0, 2.0, 0.0], r"\"a\" has -1 N, beyond"),
        ([3.0, 3.0, 0.0], r"\"b\" has 3 N, and follows \"a\" with the gain -1, by which it has -2 N, which is beyond its bounds"),
        ([0.75, 0.5, 0.0], r"by which it has 0.25 N: give it that, or NaN"),
        ([1.5, np.nan, 0.0], r"\"b\" has -0.5 N, beyond"),
        ([np.nan, np.nan, 0.0], "finite"),
        ([0.5, 0.5, -0.05], r"\"w\" has -0.05 m, beyond its bounds, \[-0.02, 0.01\] m of tendon.2.displacement_m"),
        ([0.5, 0.5, np.inf], "finite"),
    ],
)
def test_efforts_beyond_bounds_are_refused(efforts, words):
    """A plant, a batch and shapes at rest take no effort beyond the bounds of its actuator, nor one that does not follow another as it should."""
    scene = sa.Scene(PAIR_AND_WINCH)
    plant, arms = scene.plant(), sa.batch(scene, 2)
    before = plant.state.x
    with pytest.raises(ValueError, match="efforts: .*" + words):
        plant.step(0.02, None, efforts)
    with pytest.raises(ValueError, match="efforts_to: "):
        plant.step(0.02, None, [0.5, 0.5, 0.0], efforts_to=efforts)
    with pytest.raises(ValueError, match="efforts of arm 1: .*" + words):
        arms.step(0.02, None, [[0.5, 0.5, 0.0], efforts])
    with pytest.raises(ValueError, match="inputs of row 1: .*" + words):
        scene.shapes([[0.5, 0.5, 0.0], efforts, [0.5, 0.5, 0.0]])
    assert plant.time == arms.times[1] == 0.0 and np.array_equal(plant.state.x, before)


def test_efforts_within_bounds_are_taken_but_for_rounding():
    """NaN stands for the effort of an actuator that follows another one, and single precision is within the bounds."""
    scene = sa.Scene(PAIR_AND_WINCH | {"tendon": [own | {"tension_n": [0.0, 1.1]} if "tension_n" in own else own for own in PAIR_AND_WINCH["tendon"]]})
    scene = scene.replace({"tendon.0.pretension_n": 0.55, "tendon.1.pretension_n": 0.55})
    plant, other = scene.plant(), scene.plant()
    assert plant.bounds == {"a": (0.0, 1.1), "b": (0.0, 1.1), "w": (-0.02, 0.01)}
    plant.step(0.02, None, [0.8, np.nan, -0.002])
    other.step(0.02, None, [0.8, 0.3, -0.002])
    assert plant.efforts["b"] == pytest.approx(0.3, rel=1e-12) and np.allclose(plant.state.x, other.state.x, rtol=0, atol=1e-12)
    single = np.array([1.1, 0.0, 0.01], dtype=np.float32)
    assert float(single[0]) > 1.1
    plant.step(0.02, None, single)
    sa.batch(scene, 1).step(0.02, None, single[None])
    rows = scene.shapes({"a": [0.8, 0.5]}).x
    assert np.allclose(rows, scene.shapes([[0.8, 0.3, 0.0], [0.5, 0.6, 0.0]]).x, rtol=0, atol=1e-9)


def test_tendons_without_bounds_pull_only():
    """A tendon of which the scene gives no bounds takes any tension but a push, and a rod that pushes in the scene, or a chamber, both."""
    keys = sa.arm(0.3, 0.006, 1e6, elements=6) | {"time": {"end_s": 0.5}}
    tendon = {"name": "a", "offset_m": [0.005, 0.0]}
    arm = sa.Scene(keys | {"tendon": [tendon]})
    assert arm.plant().bounds == {"a": (0.0, np.inf)}
    arm.shapes([[0.0], [2.0], [-1e-12]])
    for refused in (lambda: arm.shapes([[-0.1]]), lambda: arm.plant().step(1e-3, None, [-0.1])):
        with pytest.raises(ValueError, match=r"\"a\" has -0.1 N, and cannot push; bounds in tendon.0.tension_n"):
            refused()
    for pushes in ({"tension_n": [-1.0, 1.0]}, {"pretension_n": -0.05}):
        rod = sa.Scene(keys | {"tendon": [tendon | pushes]})
        assert rod.shapes([[-0.1]]).tips[0, 0] * arm.shapes([[0.1]]).tips[0, 0] < 0.0
    chamber = sa.Scene(keys | {"chamber": [{"area_m2": 1e-5, "offset_m": [0.003, 0.0]}]})
    assert np.isfinite(chamber.shapes([[-1e3]]).tips).all()
    # The bounds of a row are those of its own scene.
    arm = sa.Scene(keys | {"tendon": [tendon | {"tension_n": [0.0, 1.0]}]})
    arm.shapes([[1.5]], changes={"tendon.0.tension_n.1": [2.0, 3.0]})
    with pytest.raises(ValueError, match="row 1: .*beyond its bounds, \\[0, 1.25\\] N"):
        arm.shapes([[1.5]], changes={"tendon.0.tension_n.1": [2.0, 1.25]})
