"""A first guess: the arm bends through static shapes to one that holds the goal, as in `softarm`'s own."""

import casadi as ca
import numpy as np
from scipy.spatial.transform import Rotation

import rod as discrete

TURN = 0.3
"""Angle in rad between the planes in which the arm begins and ends to bend.

Straight arm and position goal have a plane of symmetry. A guess within it keeps every Newton-type method in it, and the best motion in it is
a saddle of the problem.
"""

NEARLY_REST = 0.05
"""Share of the way that leaves the plane of symmetry and little else."""


def static_shape(problem):
    """Configuration [K, 6] and scaled wrench [6] of least norm that holds the goal.

    Springs pull the tip there, soft ones first: the arm is to bend toward the goal, where a stiff one would press it together.
    """
    rod = problem.rod
    c, wrench, spring = ca.SX.sym("c", 6 * rod.n_elements), ca.SX.sym("wrench", 6), ca.SX.sym("spring")
    x, s = discrete.split(rod, c)
    q = [discrete.quaternion(s) for s in s]
    f, m = discrete.forces(rod, x, q)
    f[-1] += problem.force_scale * wrench[:3]
    m[-1] += problem.moment_scale * wrench[3:]
    miss = discrete.pose_error(rod, x[-1], q[-1], problem.position, problem.orientation)
    balance = ca.vertcat(*(f / problem.force_scale for f in f), *(m / problem.moment_scale for m in m))
    cost = (ca.dot(wrench, wrench) + spring * ca.dot(miss, miss)) / 2
    options = {"print_time": False, "ipopt": {"print_level": 0, "sb": "yes"}}
    solver = ca.nlpsol("shape", "ipopt", {"x": ca.vertcat(c, wrench), "p": spring, "f": cost, "g": balance}, options)
    found = np.concatenate([discrete.rest(rod), np.zeros(6)])
    for stiffness in 10.0 ** np.arange(7):
        found = solver(x0=found, p=stiffness, lbg=0, ubg=0)["x"]
    found = np.array(found).ravel()
    return found[:-6].reshape(-1, 6), found[-6:]


def static_path(problem, share):
    """Configurations [N + 1, K, 6], and the scaled wrenches [M, 6] that hold them in the middle of the blocks, roughly.

    Bends, stretches and wrenches reach this share of those of the shape at the goal. A small one is rest, but for the plane of symmetry.
    """
    K, N, M, length = problem.rod.n_elements, problem.n_steps, problem.n_blocks, problem.rod.element_length
    shape, wrench = static_shape(problem)
    nodes = np.vstack([np.zeros(3), shape[:, :3]])
    frames = Rotation.from_mrp(np.vstack([np.zeros(3), shape[:, 3:]]))
    bends = (frames[:-1].inv() * frames[1:]).as_rotvec()
    chords = frames[:-1].inv().apply(np.diff(nodes, axis=0))

    def fraction(t):
        return t**3 * (10 - 15 * t + 6 * t**2)

    def turn(along):
        return Rotation.from_rotvec(np.outer(TURN * (along - 1), [0, 0, 1]))

    along = fraction(np.arange(N + 1) / N)
    path, x, frame = np.empty((N + 1, K, 6)), np.zeros((N + 1, 3)), Rotation.identity(N + 1)
    straight = np.array([0, 0, length])
    for q in range(K):
        x = x + frame.apply(straight + np.outer(share * along, chords[q] - straight))
        frame = frame * Rotation.from_rotvec(np.outer(share * along, bends[q]))
        path[:, q, :3] = turn(along).apply(x)
        path[:, q, 3:] = (turn(along) * frame * turn(along).inv()).as_mrp()
    along = fraction((np.arange(M) + 0.5) / M)
    holds = np.hstack([turn(along).apply(np.outer(share * along, part)) for part in (wrench[:3], wrench[3:])])
    return path, holds
