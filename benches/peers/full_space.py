"""Full-space transcriptions: all states and all controls are variables, the step is a constraint; IPOPT and fatrop.

CasADi is given every function of the nonlinear program ready-made: values, Jacobian and Hessian of one stage (or of one element and
one node) are compiled, mapped over the stages, and their nonzeros summed into place by a constant sparse matrix. Left to itself it would
color and differentiate the graph of all stages.
"""

import time

import casadi as ca
import numpy as np
import scipy.sparse as sp

import rod as discrete
from compiled import compiled
from start import NEARLY_REST, static_path


class Assembly:
    """Nonzeros of a sparse matrix, as sums of values that come in lists."""

    def __init__(self, shape):
        self.shape, self.rows, self.columns, self.values = shape, [], [], []
        self.constants = sp.csc_matrix(shape)

    def add(self, rows, columns, values):
        """Entry i of the MX `values` belongs at (rows[i], columns[i])."""
        rows, columns = np.asarray(rows).ravel(), np.asarray(columns).ravel()
        assert values.numel() == rows.size == columns.size
        self.rows.append(rows)
        self.columns.append(columns)
        self.values.append(ca.vec(values))

    def add_constant(self, rows, columns, value):
        value = np.broadcast_to(value, np.shape(rows)).astype(float)
        self.constants = self.constants + sp.csc_matrix((value, (rows, columns)), self.shape)

    def matrix(self):
        """The sum as an MX of fixed sparsity; entries with row -1 are left out."""
        rows = np.concatenate([np.empty(0, int), *self.rows])
        columns = np.concatenate([np.empty(0, int), *self.columns])
        used = np.flatnonzero((rows >= 0) & (columns >= 0))
        keys = columns[used].astype(np.int64) * self.shape[0] + rows[used]
        constant = self.constants.tocoo()
        constant_keys = constant.col.astype(np.int64) * self.shape[0] + constant.row
        pattern, where = np.unique(np.concatenate([keys, constant_keys]), return_inverse=True)
        column_of, row_of = pattern // self.shape[0], pattern % self.shape[0]
        starts = np.searchsorted(column_of, np.arange(self.shape[1] + 1))
        sparsity = ca.Sparsity(*self.shape, starts.tolist(), row_of.tolist())
        offset = np.zeros(pattern.size)
        np.add.at(offset, where[keys.size :], constant.data)
        total = ca.MX(ca.DM(offset))
        if keys.size:
            gather = sp.csc_matrix((np.ones(keys.size), (where[: keys.size], used)), (pattern.size, rows.size))
            total = total + ca.mtimes(ca.DM(gather), ca.vertcat(*self.values))
        return ca.MX(sparsity, total)


class Kernel:
    """A function of one vector z (and data d that it is not differentiated by), compiled with its derivatives, and mapped."""

    def __init__(self, name, z, d, value):
        y = ca.SX.sym("y", value.shape[0])
        jacobian = ca.jacobian(value, z)
        hessian = ca.hessian(ca.dot(y, value), z)[0]
        self.jacobian_pattern = np.array(jacobian.sparsity().get_triplet())
        self.hessian_pattern = np.array(hessian.sparsity().get_triplet())
        self.compile_seconds = 0.0
        self._functions = {}
        for suffix, inputs, output in (
            ("value", [z, d], value),
            ("jacobian", [z, d], ca.vertcat(*jacobian.nz) if jacobian.nnz() else ca.SX(0, 1)),
            ("hessian", [z, d, y], ca.vertcat(*hessian.nz) if hessian.nnz() else ca.SX(0, 1)),
        ):
            function, seconds = compiled(ca.Function(f"{name}_{suffix}", inputs, [output]))
            self.compile_seconds += seconds
            self._functions[suffix] = function

    def __call__(self, what, n, *arguments):
        """Columns: one evaluation each."""
        return self._functions[what].map(n)(*arguments)


class Program:
    """min f(w), lower <= g(w) <= upper, gathered from kernels."""

    def __init__(self, n_variables):
        self.n = n_variables
        self.rows = 0
        self.w = ca.MX.sym("w", n_variables)
        self.f_scale, self.multipliers = ca.MX.sym("lam_f"), None
        self.terms, self.linear = [], []
        self.lower, self.upper, self.start = [], [], np.zeros(n_variables)
        self.names = {}
        self.weights = np.zeros(n_variables)
        """Of the objective, 1/2 sum weights w^2."""
        self.compile_seconds = 0.0

    def new_rows(self, n, lower=0.0, upper=0.0):
        rows = np.arange(self.rows, self.rows + n)
        self.rows += n
        self.lower += [lower] * n
        self.upper += [upper] * n
        return rows

    def add_kernel(self, kernel, variables, data, rows):
        """g[rows[i, j]] += kernel_i(w[variables[:, j]], data[:, j]); a variable -1 is the constant 0, a row -1 is dropped."""
        self.terms.append((kernel, np.asarray(variables), np.asarray(data, float), np.asarray(rows)))
        self.compile_seconds += kernel.compile_seconds

    def add_linear(self, rows, columns, value):
        """g[rows[i]] += value w[columns[i]]."""
        self.linear.append((np.asarray(rows), np.asarray(columns), value))

    def _take(self, vector, index):
        padded = ca.vertcat(vector, 0)
        return ca.reshape(padded[np.where(index < 0, vector.shape[0], index).ravel("F").tolist()], *index.shape)

    def functions(self, triangular):
        """The five functions that the plugins ask CasADi for: IPOPT the upper triangle of the Hessian, fatrop the whole."""
        w, y = self.w, ca.MX.sym("lam_g", self.rows)
        p = ca.MX.sym("p", 0)
        objective = ca.dot(ca.DM(self.weights) * w, w) / 2
        constants = Assembly((self.rows, self.n))
        for rows, columns, value in self.linear:
            constants.add_constant(rows, columns, value)
        values, jacobian = Assembly((self.rows, 1)), Assembly((self.rows, self.n))
        jacobian.constants = constants.constants
        hessian = Assembly((self.n, self.n))
        weighted = np.flatnonzero(self.weights)
        hessian.add(weighted, weighted, self.f_scale * ca.DM(self.weights[weighted]))
        for kernel, variables, data, rows in self.terms:
            n = variables.shape[1]
            z, d = self._take(w, variables), ca.DM(data)
            values.add(rows.ravel("F"), np.zeros(rows.size, int), kernel("value", n, z, d))
            i, j = kernel.jacobian_pattern
            jacobian.add(rows[i].ravel("F"), np.where(rows[i] < 0, -1, variables[j]).ravel("F"), kernel("jacobian", n, z, d))
            i, j = kernel.hessian_pattern
            at, on = variables[i], variables[j]
            if triangular:
                at = np.where(at <= on, at, -1)
            hessian.add(at.ravel("F"), on.ravel("F"), kernel("hessian", n, z, d, self._take(y, rows)))
        g = ca.mtimes(ca.DM(constants.constants), w) + ca.densify(values.matrix())
        gradient = ca.DM(self.weights) * w
        jacobian = jacobian.matrix()
        out = {
            "nlp_f": ca.Function("nlp_f", [w, p], [objective], ["x", "p"], ["f"]),
            "nlp_g": ca.Function("nlp_g", [w, p], [g], ["x", "p"], ["g"]),
            "nlp_jac_g": ca.Function("nlp_jac_g", [w, p], [g, jacobian], ["x", "p"], ["g", "jac_g_x"]),
        }
        inputs, names = [w, p, self.f_scale, y], ["x", "p", "lam_f", "lam_g"]
        slope = self.f_scale * gradient + ca.mtimes(jacobian.T, y)
        outputs = ["f", "g", "grad_gamma_x", "grad_gamma_p"]
        out["nlp_grad"] = ca.Function("nlp_grad", inputs, [objective, g, slope, ca.MX(0, 1)], names, outputs)
        if triangular:
            out["nlp_grad_f"] = ca.Function("nlp_grad_f", [w, p], [objective, gradient], ["x", "p"], ["f", "grad_f_x"])
            out["nlp_hess_l"] = ca.Function("nlp_hess_l", inputs, [hessian.matrix()], names, ["triu_hess_gamma_x_x"])
        else:
            outputs = ["grad_gamma_x", "hess_gamma_x_x"]
            out["nlp_grad_f"] = ca.Function("nlp_grad_f", [w, p], [gradient], ["x", "p"], ["grad_f_x"])
            out["nlp_hess_l"] = ca.Function("nlp_hess_l", inputs, [slope, hessian.matrix()], names, outputs)
        return {"x": w, "p": p, "f": objective, "g": g}, out

    def solve(self, plugin, options):
        """Dictionary: w, status, iterations, success, wall and CPU seconds of the solver, seconds to build."""
        begin = time.perf_counter()
        nlp, functions = self.functions(triangular=plugin == "ipopt")
        solver = ca.nlpsol("solver", plugin, nlp, {"cache": functions, "print_time": False, **options})
        build = time.perf_counter() - begin
        wall, cpu = time.perf_counter(), time.process_time()
        found = solver(x0=self.start, lbg=self.lower, ubg=self.upper)
        wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
        stats = solver.stats()
        return {
            "w": np.array(found["x"]).ravel(),
            "success": bool(stats["success"]),
            "status": stats.get("return_status", ""),
            "iterations": int(stats.get("iter_count", -1)),
            "wall_s": wall,
            "cpu_s": cpu,
            "build_s": build,
            "compile_s": self.compile_seconds,
        }


def _ball_kernel():
    u = ca.SX.sym("u", 3)
    return Kernel("ball", u, ca.SX(0, 1), ca.dot(u, u))


STATE_SCALE = 1e-4
"""What a unit of a state (m, 1, and the same over a time step) counts: it weighs defects of the dynamics against the goal in fatrop's filter.

Measured at K = 2, N = 100: 14 iterations, 32 at 1.
"""


def _state_units(h):
    return STATE_SCALE * np.repeat([1.0, h], 6)


def _node_kernels(problem):
    """Minus the explicit step of a node inside and of the tip, and the goal.

    Variables: configuration of the node before, configuration and velocities of the node, then the configuration of the node after, or the
    scaled control (not for the goal).
    """
    rod, h, goal = problem.rod, problem.step, (problem.position, problem.orientation)
    rest = ca.DM([0, 0, rod.element_length])
    units = _state_units(h)

    def element(first, second):
        return discrete.element_forces(rod, rest + second[:3] - first[:3], discrete.quaternion(first[3:6]), discrete.quaternion(second[3:6]))

    def node(n_after):
        z = ca.SX.sym("z", 18 + n_after)
        before, own, after = z[:6] / STATE_SCALE, z[6:18] / units, z[18:]
        force, _, moment = element(before, own)
        return z, own, after, force, moment

    def state(own):
        return own[:3], discrete.quaternion(own[3:6]), own[6:9], own[9:]

    z, own, after, force, moment = node(6)
    back, turning, _ = element(own, after / STATE_SCALE)
    step = discrete.advance(rod, h, rod.share[0], *state(own), force - back, moment + turning, ca.SX.zeros(6))
    inside = Kernel(f"inside_{rod.strain}", z, ca.SX(0, 1), -units * ca.vertcat(*step))
    z, own, after, force, moment = node(6)
    step = discrete.advance(rod, h, rod.share[-1], *state(own), force, moment, problem.scales * after)
    tip = Kernel(f"tip_{rod.strain}", z, ca.SX(0, 1), -units * ca.vertcat(*step))
    z, own, _, force, moment = node(0)
    position = own[:3] + ca.DM([0, 0, rod.length])
    end = discrete.tip_goal(rod, h, position, *state(own)[1:], force, moment, *goal)
    return inside, tip, Kernel(f"goal_{rod.strain}", z, ca.SX(0, 1), end)


def stages(problem):
    """States (displacement from the straight arm, rotation, velocities of every node), explicit steps, and stages as fatrop wants them.

    Stages in time order, in each the states before the controls, and in the constraints the step's before the others. No variable
    belongs to several stages: the control is a state on all but the first step of a block. The first stage has no other states,
    its configuration is given. Starts at rest: zeros. Returns the program and `controls` [6, n_blocks] (indices), and the keys N, nx, nu, ng.
    """
    rod, N, K, per = problem.rod, problem.n_steps, problem.rod.n_elements, problem.steps_per_block
    states, acting, nx, nu, at = np.full((12, K + 1, N + 1), -1), np.full((6, N + 1), -1), [], [], 0
    for k in range(N + 1):
        n_state = 12 * K if k > 0 else 0
        n_control = 6 if k < N else 0
        if n_state:
            states[:, 1:, k] = np.arange(at, at + n_state).reshape(K, 12).T
        if n_control:
            acting[:, k] = np.arange(at + n_state, at + n_state + 6)
        at += n_state + n_control
        nu.append(n_control if k % per == 0 else 0)
        nx.append(n_state + n_control - nu[-1])
    controls = acting[:, :N:per]
    program = Program(at)
    balls = problem.bounds
    rows, limits, clear, ng = np.full((12, K + 1, N), -1), [[] for _ in balls], [], []
    for k in range(N + 1):
        if k < N:
            rows[:, 1:, k] = program.new_rows(12 * K).reshape(K, 12).T
            program.add_linear(rows[:, 1:, k].ravel(), states[:, 1:, k + 1].ravel(), 1.0)
            if (k + 1) % per:
                same = program.new_rows(6)
                program.add_linear(same, acting[:, k + 1], 1.0)
                program.add_linear(same, acting[:, k], -1.0)
        before = program.rows
        if nu[k]:
            for found, (_, limit) in zip(limits, balls):
                found.append(program.new_rows(1, -np.inf, limit**2)[0])
        if k > 0 and problem.sphere is not None:
            clear.append(program.new_rows(K, problem.sphere[3] ** 2, np.inf))
        if k == N:
            goals = program.new_rows(problem.n_goals)
        ng.append(program.rows - before)
    inside, tip, end = _node_kernels(problem)
    none = np.zeros((0, 1))
    nodes, times = (index.ravel() for index in np.meshgrid(np.arange(1, K), np.arange(N), indexing="ij"))
    variables = [states[:6, nodes - 1, times], states[:, nodes, times], states[:6, nodes + 1, times]]
    program.add_kernel(inside, np.vstack(variables), np.zeros((0, nodes.size)), rows[:, nodes, times])
    variables = np.vstack([states[:6, K - 1], states[:, K]])
    program.add_kernel(tip, np.vstack([variables[:, :N], acting[:, :N]]), np.zeros((0, N)), rows[:, K])
    program.add_kernel(end, variables[:, N:], none, goals[:, None])
    for found, (part, _) in zip(limits, balls):
        program.add_kernel(_ball_kernel(), controls[part], np.zeros((0, controls.shape[1])), np.array(found)[None])
    if clear:
        _add_sphere(program, problem, states[:3, 1:, 1:], np.array(clear).T, STATE_SCALE)
    program.weights[controls] = problem.step * per
    return program, {"controls": controls, "N": N, "nx": nx, "nu": nu, "ng": ng}


def _add_sphere(program, problem, places, rows, size):
    """Square of the distance of every node at every time node; places [3, K, N] of displacements times `size`, rows [K, N]."""
    x, rest = ca.SX.sym("x", 3), ca.SX.sym("rest")
    difference = x / size + ca.vertcat(0, 0, rest) - ca.DM(problem.sphere[:3])
    kernel = Kernel("distance", x, rest, ca.dot(difference, difference))
    heights = np.repeat(discrete.rest(problem.rod)[2::6], problem.n_steps)
    program.add_kernel(kernel, places.reshape(3, -1), heights[None], rows.reshape(1, -1))


def solve_stages(problem, max_iterations=1000, verbose=0):
    """By fatrop; adds `u` [n_blocks, 6] in N and N m to the answer."""
    program, layout = stages(problem)
    options = {
        "structure_detection": "manual",
        **{key: layout[key] for key in ("N", "nx", "nu", "ng")},
        "equality": [lower == upper for lower, upper in zip(program.lower, program.upper)],
        "fatrop": {"tolerance": 1e-6, "max_iter": max_iterations, "print_level": verbose},
    }
    found = program.solve("fatrop", options)
    found["u"] = found["w"][layout["controls"]].T * problem.scales
    return found


def ipopt_options(max_iterations, verbose):
    return {
        "print_level": verbose,
        "sb": "yes",
        "tol": 1e-6,
        "constr_viol_tol": 1e-8,
        "max_iter": max_iterations,
        "linear_solver": "mumps",
        # Without scaling and with METIS: less time than with MUMPS's own choices or any other of its orderings.
        "mumps_permuting_scaling": 0,
        "mumps_scaling": 0,
        "mumps_pivot_order": 5,
    }


ROW_WEIGHT = 2e-4
"""What a defect of 1 m/s or 1 rad/s counts beside the goal, in the filter; at K = 4 from rest 14 iterations, 22 at 2e-3, and
no convergence in 14 at 0.03 and 1, where most steps are cut."""


def _interval_kernel(rod, h, weight):
    """Of one node and interval: angular velocities J^-1 pi that leave its first time node, and minus those that arrive at the second."""
    z = ca.SX.sym("z", 6)
    relative = discrete.product(discrete.conjugate(discrete.quaternion(z[:3])), discrete.quaternion(z[3:]))
    f = 2 * relative[1:] / relative[0]
    inertia = ca.DM(rod.rotary) / rod.rotary[0]
    straight, skew = inertia * f, ca.cross(f, inertia * f) / 2
    scale = weight / (h * (1 + ca.dot(f, f) / 4))
    leaving, arriving = scale * (straight + skew), scale * (straight - skew)
    return Kernel(f"interval_{rod.rotary[2] / rod.rotary[0]:.0f}", z, ca.SX(0, 1), ca.vertcat(leaving / inertia, -arriving / inertia))


def _element_kernel(rod, scale):
    """Minus the changes of velocity that an element gives its two ends in the time `scale`.

    Variables: displacement from the straight rod and rotation of both ends; data: the length lumped on each.
    """
    z, share = ca.SX.sym("z", 12), ca.SX.sym("share", 2)
    qa, qb = discrete.quaternion(z[3:6]), discrete.quaternion(z[9:])
    force, first, second = discrete.element_forces(rod, ca.DM([0, 0, rod.element_length]) + z[6:9] - z[:3], qa, qb)
    rotary = ca.DM(rod.rotary)
    value = [force / rod.mass / share[0], -first / rotary / share[0], -force / rod.mass / share[1], -second / rotary / share[1]]
    return Kernel(f"element_{rod.strain}", z, share, scale * ca.vertcat(*value))


def _orientation_kernel(rotation):
    target = ca.DM(np.array(rotation) / np.linalg.norm(rotation))
    z = ca.SX.sym("z", 3)
    return Kernel("orientation", z, ca.SX(0, 1), discrete.logarithm(discrete.product(discrete.conjugate(target), discrete.quaternion(z))))


def configurations(problem, from_rest=False):
    """The same program over configurations alone: discrete Euler-Lagrange equations between three time nodes, as DMOC states it.

    Every force is that of one element at one time node and every inertia that of one node in one interval, so all derivatives are
    those of two small kernels. Rows are velocities, m/s and rad/s. Returns the program and the indices `controls` [6, n_blocks].
    """
    rod, h, N, K = problem.rod, problem.step, problem.n_steps, problem.rod.n_elements
    per, shares = problem.steps_per_block, rod.share
    # Stages in time order, the controls of a block before its first stage; nodes 0..K, of which node 0 and time 0 are constants.
    at, place, controls = 0, np.full((6, K + 1, N + 1), -1), np.empty((6, problem.n_blocks), int)
    for k in range(N + 1):
        if k < N and k % per == 0:
            controls[:, k // per] = np.arange(at, at + 6)
            at += 6
        if k > 0:
            place[:, 1:, k] = np.arange(at, at + 6 * K).reshape(K, 6).T
            at += 6 * K
    program = Program(at)
    # Positions are displacements from the straight rod, so that constants are zeros.
    rows = np.full((6, K + 1, N + 1), -1)
    for k in range(N):
        rows[:, 1:, k] = program.new_rows(6 * K).reshape(K, 6).T
    n_goals = problem.n_goals
    goals = program.new_rows(n_goals)
    rows[:, K, N] = goals[-6:]

    def linear(row, column, value):
        used = (row >= 0) & (column >= 0)
        program.add_linear(row[used], column[used], value)

    for k in range(N):
        for row_time, sign in ((k, 1), (k + 1, -1)):
            linear(rows[:3, 1:, row_time], place[:3, 1:, k + 1], ROW_WEIGHT * sign / h)
            linear(rows[:3, 1:, row_time], place[:3, 1:, k], -ROW_WEIGHT * sign / h)
    nodes, times = np.meshgrid(np.arange(1, K + 1), np.arange(N), indexing="ij")
    nodes, times = nodes.ravel(), times.ravel()
    variables = np.vstack([place[3:, nodes, times], place[3:, nodes, times + 1]])
    angular = np.vstack([rows[3:, nodes, times], rows[3:, nodes, times + 1]])
    program.add_kernel(_interval_kernel(rod, h, ROW_WEIGHT), variables, np.zeros((0, nodes.size)), angular)
    for first, last, weight in ((1, N, h), (N, N + 1, h / 2)):
        elements, times = np.meshgrid(np.arange(K), np.arange(first, last), indexing="ij")
        elements, times = elements.ravel(), times.ravel()
        variables = np.vstack([place[:, elements, times], place[:, elements + 1, times]])
        share = np.concatenate([[1.0], shares])
        program.add_kernel(
            _element_kernel(rod, ROW_WEIGHT * weight),
            variables,
            np.vstack([share[elements], share[elements + 1]]),
            np.vstack([rows[:, elements, times], rows[:, elements + 1, times]]),
        )
    for k in range(N):
        for row_time in (k, k + 1):
            for i in range(6):
                linear(rows[i : i + 1, K, row_time], controls[i : i + 1, k // per], -ROW_WEIGHT * h / 2 * problem.scales[i] / rod.tip_inertia[i])
    target = np.array(problem.position) - [0, 0, rod.length]
    program.add_linear(goals[:3], place[:3, K, N], 1 / rod.length)
    for row, value in zip(goals[:3], target / rod.length):
        program.lower[row] = program.upper[row] = value
    if problem.orientation is not None:
        program.add_kernel(_orientation_kernel(problem.orientation), place[3:, K, N:], np.zeros((0, 1)), goals[3:6, None])
    for part, limit in problem.bounds:
        rows_of_bound = program.new_rows(problem.n_blocks, -np.inf, limit**2)
        program.add_kernel(_ball_kernel(), controls[part], np.zeros((0, problem.n_blocks)), rows_of_bound[None])
    if problem.sphere is not None:
        clear = program.new_rows(K * N, problem.sphere[3] ** 2, np.inf)
        _add_sphere(program, problem, place[:3, 1:, 1:], clear.reshape(K, N), 1.0)
    # The short motions of few elements are nearer to rest than to static shapes: from those IPOPT diverges at K = 2.
    path, holds = static_path(problem, NEARLY_REST if from_rest or K <= 4 else 1.0)
    program.start[place[:, 1:, 1:]] = (path[1:] - discrete.rest(rod).reshape(K, 6)).T
    program.start[controls] = holds.T
    program.weights[controls] = h * per
    return program, controls


def solve_configurations(problem, from_rest=False, max_iterations=1000, verbose=0):
    """By IPOPT; adds `u` [n_blocks, 6] in N and N m to the answer."""
    program, controls = configurations(problem, from_rest)
    options = {f"ipopt.{k}": v for k, v in ipopt_options(max_iterations, verbose).items()}
    found = program.solve("ipopt", options)
    found["u"] = found["w"][controls].T * problem.scales
    return found
