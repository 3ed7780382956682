"""The optimal-control problem as arrays: derivatives against differences of motions, and a solver of a few lines against that of softarm."""

import numpy as np
import pytest
import softarm as sa


@pytest.fixture(scope="module")
def program() -> sa.Program:
    keys = {"rod.elements": 4, "control.blocks": 6, "control.hold": "constant"}
    return sa.Scene.load("reach").replace(keys).program()


@pytest.fixture(scope="module")
def point(program: sa.Program) -> np.ndarray:
    return program.guess() + 0.1 * np.random.default_rng(0).standard_normal(program.n_variables)


def direction(program: sa.Program) -> np.ndarray:
    return np.random.default_rng(1).standard_normal(program.n_variables)


def slope(function, at: np.ndarray, along: np.ndarray, step: float = 1e-5):
    return (function(at + step * along) - function(at - step * along)) / (2 * step)


def test_first_derivatives(program, point):
    d = direction(program)
    local = program.linearize(point)
    value, constraints, _ = program.evaluate(point)
    assert local.objective == value
    np.testing.assert_array_equal(local.constraints, constraints)
    along = slope(lambda v: program.evaluate(v)[0], point, d)
    assert local.gradient @ d == pytest.approx(along, rel=1e-6)
    along = slope(lambda v: program.evaluate(v)[1], point, d)
    np.testing.assert_allclose(local.jacobian @ d, along, atol=1e-6 * np.abs(along).max())


def test_second_derivatives(program, point):
    d = direction(program)
    y = np.random.default_rng(2).standard_normal(len(program.evaluate(point)[1]))

    def gradient(v):
        local = program.linearize(v)
        return local.gradient + y @ local.jacobian

    hessian = program.linearize(point, constraint_multipliers=y).hessian
    along = slope(gradient, point, d)
    np.testing.assert_allclose(hessian @ d, along, atol=1e-5 * np.abs(along).max())
    np.testing.assert_allclose(hessian, hessian.T, atol=1e-9 * np.abs(hessian).max())


def test_sensitivities_of_the_motion(program, point):
    d = direction(program)
    dx, dz = program.sensitivity(point, d)
    assert dx.shape == dz.shape == program.rollout(point)[0].shape
    along = slope(lambda v: program.rollout(v)[0], point, d)
    np.testing.assert_allclose(dx, along, atol=1e-6 * np.abs(along).max())
    R = program.rollout(point)[1]
    turned = np.swapaxes(R, -1, -2) @ slope(lambda v: program.rollout(v)[1], point, d)
    along = np.stack([turned[..., 2, 1], turned[..., 0, 2], turned[..., 1, 0]], axis=-1)
    np.testing.assert_allclose(dz, along, atol=1e-6 * np.abs(along).max())


def test_transitions_move_the_state_as_sensitivities_do(program, point):
    """The first coefficient of a constant hold acts over the first block alone; the second block carries on what is left of it."""
    blocks = program.transitions(point)
    assert len(blocks) == len(program.blocks) - 1
    ends = [int(np.argmin(np.abs(program.times - t))) for t in program.blocks]
    n = len(program.components)
    for i, component in enumerate(program.components):
        dx, dz = program.sensitivity(point, np.eye(program.n_variables)[i])
        state = blocks[0][1][:, i] * component.unit
        for (a, _), end in zip(blocks[1:], ends[1:]):
            moved = state.reshape(-1, 12)
            free = dx.shape[1] - len(moved)
            np.testing.assert_allclose(moved[:, :3], dx[end, free:], atol=1e-9 * np.abs(dx).max())
            np.testing.assert_allclose(moved[:, 3:6], dz[end, free:], atol=1e-9 * np.abs(dz).max())
            state = a @ state
    assert blocks[0][1].shape == (12 * (program.rollout(point)[0].shape[1] - 1), n)


def test_a_solver_of_ten_lines_finds_the_same_optimum():
    """Far from all bounds: Gauss and Newton's method on the conditions of Kuhn and Tucker, with the exact Hessian near the end."""
    keys = sa.Scene.load("reach").to_dict()
    keys["rod"]["elements"] = 4
    keys["task"] = {"position_m": [0.5, 0.0, 0.84], "at_rest": False}
    keys["control"] |= {"force_max_n": 1e3, "moment_max_n_m": 1e3}
    scene = sa.Scene(keys)
    program = scene.program()
    v, y = program.guess(), None
    for _ in range(60):
        local = program.linearize(v, y)
        m, n = local.jacobian.shape
        kkt = np.block([[local.hessian, local.jacobian.T], [local.jacobian, np.zeros((m, m))]])
        step = np.linalg.solve(kkt, -np.concatenate([local.gradient, local.constraints]))
        v, change = v + step[:n], np.abs(step[:n]).max()
        y = step[n:] if change < 0.02 else None
        if change < 1e-9:
            break
    assert np.abs(program.evaluate(v)[1]).max() < 1e-9
    assert program.evaluate(v)[0] == pytest.approx(scene.solve().summary["objective"], rel=1e-6)


def test_refusals(program):
    with pytest.raises(ValueError, match="variables has the shape"):
        program.evaluate([0.0])
    with pytest.raises(ValueError, match="rows"):
        program.linearize(program.guess(), rows=[5, 3])
    with pytest.raises(sa.SceneError):
        sa.Scene.load("swing").program()


@pytest.mark.parametrize(
    "name, changes, keys",
    [
        # The tip stops for an instant, and a bound on the force is active.
        ("reach", {"rod.elements": 5, "control.force_max_n": 1.2, "task.at_rest": "tip", "task.stays_m": None}, ["rod.material.youngs_modulus_pa", "control.force_max_n"]),
        # The arm stays, with an end that is fixed and soft rows in a ball, whose basis differs between two programs.
        ("reach", {"rod.elements": 5}, ["task.position_m.0", "rod.material.density_kg_m3"]),
        # Fewer controls than rows of the stay, and a bound that does not act.
        ("reach-tendons", {"rod.elements": 8, "control.blocks": 4}, ["damping.viscous_1_s"]),
        # Rows of an obstacle.
        ("reach-obstacle", {"rod.elements": 6}, ["obstacle.0.sphere.radius_m"]),
    ],
)
def test_derivatives_of_solutions_are_those_of_solves(name, changes, keys):
    scene = sa.Scene.load(name).replace({"control.blocks": 8, "solver.tolerance": 1e-9} | changes)
    result = scene.solve()
    assert result.status == "converged"
    whole = result.scene
    program = whole.program()
    found = program.derivatives(program.solution(result), keys)
    assert found.residual < 1e-6 and found.active > 0
    n = program.n_controls

    def solved(key, value):
        own = whole.replace({key: value}).solve(start_from=result)
        assert own.status == "converged"
        other = own.scene.program()
        units = [np.tile([part.unit for part in each.components], n // len(each.components)) for each in (program, other)]
        return other.solution(own)[:n] * units[1] / units[0], own.summary["objective"], own.x

    for i, key in enumerate(keys):
        def central(step):
            ahead, behind = solved(key, whole[key] + step), solved(key, whole[key] - step)
            return [(a - b) / (2 * step) for a, b in zip(ahead, behind)]

        step = 5e-5 * abs(whole[key])
        expected = [(4 * fine - coarse) / 3 for coarse, fine in zip(central(2 * step), central(step))]
        own = [found.variables[:n, i], found.objective[i], found.x[..., i]]
        for slope, other in zip(own, expected):
            assert np.abs(slope - other).max() < 2e-4 * np.abs(other).max(), (key, np.abs(slope - other).max() / np.abs(other).max())


def test_what_is_no_solution_has_no_derivatives(program, point):
    with pytest.raises(ValueError, match="no solution"):
        program.derivatives(point, ["rod.material.youngs_modulus_pa"])
    with pytest.raises(sa.ResultError):
        program.solution(sa.Scene.load("swing").replace({"time.end_s": 0.05}).simulate())
