"""The Python package against laws, the command line, and its own promises."""

import copy
import gc
import json
import os
import pickle
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest

import softarm as sa


@pytest.fixture(autouse=True)
def interrupts_are_heard():
    """A process in the background ignores SIGINT from its start, and Python leaves it at that."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


SHORT = {"time.end_s": 0.05}


@pytest.fixture(scope="module")
def solved():
    return sa.Scene.load("reach").solve()


def test_scenes_are_dictionaries():
    scene = sa.Scene.load("reach")
    again = sa.Scene(scene.to_dict())
    assert again == scene and hash(again) == hash(scene)
    assert scene.replace({"rod.elements": 7})["rod.elements"] == 7
    assert scene["rod.elements"] != 7
    assert pickle.loads(pickle.dumps(scene.replace({"rod.elements": 7})))["rod.elements"] == 7
    assert scene.replace({"task.position_m": np.array([0.4, 0.0, 0.8])})["task.position_m"] == [0.4, 0.0, 0.8]


@pytest.mark.parametrize("name", sa.builtin_scenes())
def test_every_scene_is_the_same_as_a_dictionary(name):
    scene = sa.Scene.load(name)
    assert sa.Scene(scene.to_dict()).to_dict() == scene.to_dict()


def test_faults_of_a_scene_name_key_and_place():
    with pytest.raises(sa.SceneError) as caught:
        sa.Scene.load("reach").replace({"rod.elemens": 3})
    assert caught.value.key == "rod.elemens" and "elements" in caught.value.help
    with pytest.raises(ValueError) as caught:
        sa.Scene("[rod]\nlength_m = -1\n")
    assert caught.value.line == 2
    assert pickle.loads(pickle.dumps(caught.value)).line == 2
    with pytest.raises(sa.SceneError):
        sa.Scene.load("no-such-scene")
    with pytest.raises(TypeError, match="object"):
        sa.Scene.load("reach").replace({"rod.elements": object()})


def test_a_solve_is_that_of_the_command_line(solved, tmp_path):
    assert solved.status == "converged" and solved.certificate
    code = subprocess.run([sys.executable, "-m", "softarm", "solve", "reach", "--quiet", "--out", tmp_path / "cli"]).returncode
    assert code == solved.exit_code == 0
    other = sa.load(tmp_path / "cli")
    assert np.array_equal(other.x, solved.x) and other.summary["objective"] == solved.summary["objective"]
    for name in ("controls.csv", "trajectory.npz", "multipliers.json"):
        assert (other.directory / name).read_bytes() == (solved.directory / name).read_bytes()


def test_arrays_have_their_shapes(solved):
    n, k = len(solved.t), sa.Scene.load("reach")["rod.elements"]
    assert solved.x.shape == (n, k + 1, 3) and solved.R.shape == (n, k + 1, 3, 3)
    assert solved.x.flags.c_contiguous and solved.R.dtype == np.float64
    identity = np.einsum("nkij,nkil->nkjl", solved.R, solved.R)
    assert np.abs(identity - np.eye(3)).max() < 1e-12
    # Body to space: the third column points along the arm, at the clamp exactly along the base.
    assert np.allclose(solved.R[:, 0, :, 2], [0, 0, 1])
    assert {"t_start", "tip force x (N)"} <= set(solved.controls.dtype.names)


def test_results_are_kept_pickled_and_verified(solved, tmp_path):
    kept = sa.load(solved.save(tmp_path / "kept"))
    assert np.array_equal(kept.x, solved.x)
    assert sa.verify(kept, quick=True).is_certified
    with pytest.raises(sa.ResultError, match="not empty"):
        solved.save(tmp_path / "kept")
    with pytest.raises(sa.ResultError):
        sa.load(tmp_path)
    other = pickle.loads(pickle.dumps(solved))
    assert np.array_equal(other.R, solved.R) and other.summary == solved.summary
    assert other.scene == solved.scene
    assert solved._repr_html_().startswith("<iframe") and "reach" in repr(solved)
    summary = json.loads((kept.directory / "summary.json").read_text())
    summary["tool"] = "other"
    (kept.directory / "summary.json").write_text(json.dumps(summary))
    with pytest.raises(sa.ResultError, match="not of softarm"):
        sa.load(kept.directory)


def test_changed_controls_are_not_certified(solved, tmp_path):
    kept = solved.save(tmp_path / "kept")
    rows = (kept / "controls.csv").read_text().splitlines()
    fields = rows[3].split(",")
    fields[2] = str(float(fields[2]) + 1.0)
    (kept / "controls.csv").write_text("\n".join([*rows[:3], ",".join(fields), *rows[4:]]) + "\n")
    assert not sa.verify(kept, quick=True)


def test_a_target_out_of_reach_is_a_status():
    """A force that can bring the arm there, but not in this time."""
    keys = sa.arm(0.3, 0.01, 1e6, gravity=False) | sa.reach([0.2, 0.0, -0.1], 0.02, 1.0, at_rest=False)
    result = sa.Scene(keys).solve()
    assert result.status != "converged" and not result.certificate


WINCH = """
[rod]
length_m = 0.2
elements = 4
[rod.material]
youngs_modulus_pa = 1e6
poisson_ratio = 0.5
density_kg_m3 = 1000.0
[rod.section]
radius_m = 0.01
[damping]
viscous_1_s = 5.0
[time]
end_s = 1.0
integrator = "implicit"
step_s = 0.01
[[tendon]]
name = "winch"
offset_m = [0.008, 0.0]
displacement_m = [-0.02, 0.0]
compliance_1_n = 1e-3
[[tendon]]
name = "other"
offset_m = [-0.008, 0.0]
tension_n = [0.0, 10.0]
"""


def test_a_plant_tells_efforts_by_name():
    """Of a tendon on a winch both the displacement and the tension, which is positive where the winch has pulled in."""
    plant = sa.Scene(WINCH).plant()
    assert plant.units == {"winch": "m", "other": "N"}
    plant.step(0.2, None, [-0.002, 0.5])
    assert plant.displacements == {"winch": -0.002}
    assert plant.efforts["other"] == 0.5 and plant.efforts["winch"] > 0.0
    assert plant.copy().efforts == plant.efforts
    plant.reset()
    assert plant.displacements == {"winch": 0.0}


def test_two_tendons_on_one_motor():
    """A controller commands both tendons of a pair, in their relation and within the bounds of both, and a plant takes them by name."""
    pair = {"tendon.2.follows": {"name": "first", "gain": -1.0}, "tendon.3.follows": {"name": "second", "gain": -1.0}}
    pair |= {f"tendon.{i}.pretension_n": 0.725 for i in range(4)}
    scene = sa.Scene.load("mpc-tendons").replace(pair | {"estimator.kind": "none", "estimator.disturbances": [], "sensor": []})
    controller, plant = scene.controller(), scene.plant()
    assert controller.actuators == ["first", "second", "third", "fourth"]
    assert [(own["name"], own["unit"], own["rest"]) for own in controller.controls] == [("first", "N", 0.725), ("second", "N", 0.725)]
    limits = {own["name"]: (own["least"], own["most"]) for own in controller.greeting["efforts"]}
    assert np.allclose(list(limits.values()), (0.0, 1.45))
    for _ in range(20):
        command = controller.step(plant.state_on(controller))
        first, third = (np.array(command.efforts[name]) for name in ("first", "third"))
        assert np.allclose(first + third, 1.45) and (np.minimum(first, third) >= -1e-12).all()
        # The controls are the two motors, by what their first tendons have.
        assert command.controls == {name: command.efforts[name] for name in ("first", "second")}
        assert np.allclose(command.controls_at(command.end), [command.efforts[name][1] for name in ("first", "second")], atol=0.0)
        plant.apply(command)
    assert abs(plant.efforts["second"] + plant.efforts["fourth"] - 1.45) < 1e-12


def test_given_efforts_act_beside_commands():
    """A plant with a chamber whose pressure the scene gives takes the commands of a controller for its tendons."""
    keys = sa.Scene.load("mpc-tendons").replace({"estimator.kind": "none", "estimator.disturbances": [], "sensor": []}).to_dict()
    keys["chamber"] = [{"name": "side", "area_m2": 2e-5, "offset_m": [0.0, 0.006], "profile": [[0.0, 500.0], [0.1, 500.0]]}]
    scene = sa.Scene(keys)
    controller, plant = scene.controller(), scene.plant()
    for _ in range(3):
        plant.apply(controller.step(plant.state_on(controller)))
    assert plant.efforts["side"] == 500.0


def test_tables_have_names_that_csv_quotes():
    """Also those with commas, quotes, `#` and ends of lines."""
    keys = sa.Scene.load("reach-tendons").replace({"rod.elements": 3, "time.end_s": 0.02}).to_dict()
    name = 'tendon "#1",\nthe first'
    keys["tendon"][0]["name"] = name
    result = sa.Scene(keys).simulate()
    efforts = result.table("efforts.csv")
    assert (efforts["name"] == name).sum() * len(keys["tendon"]) == len(efforts)
    assert efforts["effort"].dtype == np.float64
    assert result.effort_names[0] == name


def test_efforts_of_a_result_are_an_array(tmp_path):
    """Columns are actuators, with names and units; they are what a plant tells at the same times, also of a tendon on a winch."""
    scene = sa.Scene(WINCH.replace("displacement_m = [-0.02, 0.0]", "displacement_profile = [[0.0, 0.0], [0.5, -0.004]]")).replace({"time.end_s": 0.2})
    result = scene.simulate()
    assert result.effort_names == ["winch", "other"] and result.effort_units == ["N", "N"]
    assert result.efforts.shape == (len(result.t), 2) and (result.efforts[1:, 0] > 0.0).all() and (result.efforts[:, 1] == 0.0).all()
    rows = result.table("efforts.csv")
    for i, name in enumerate(result.effort_names):
        assert np.array_equal(rows["effort"][rows["name"] == name], result.efforts[:, i])
    plant = scene.plant()
    plant.step(0.2)
    assert plant.efforts["winch"] == pytest.approx(result.efforts[-1, 0], rel=1e-9)
    with pytest.raises(sa.ResultError, match="output.diagnostics"):
        result.diagnostics
    bare = sa.Scene.load("swing").replace({"time.end_s": 0.02, "output.diagnostics": True}).simulate()
    assert bare.efforts.shape == (len(bare.t), 0) and bare.effort_names == bare.effort_units == []
    found = bare.diagnostics
    assert found["linear_momentum"].shape == (len(bare.t), 3) and np.array_equal(found["t"], bare.t)


def test_a_motion_is_exported(tmp_path):
    """Files of the verb are those of the command line; what is there is kept, unless softarm wrote it or `force` says so."""
    result = sa.Scene.load("swing").replace({"rod.elements": 4, "time.end_s": 0.05}).simulate()
    for format, first in (("vtk", "motion.pvd"), ("csv", "motion.csv"), ("svg", "motion.svg")):
        assert result.export(format, tmp_path / format, frames=3) == tmp_path / format / first
        code = subprocess.run([sys.executable, "-m", "softarm", "export", result.directory, "--to", format, "--frames=3", "--out", tmp_path / "cli", "--quiet"])
        assert code.returncode == 0
        for path in (tmp_path / format).iterdir():
            assert path.read_bytes() == (tmp_path / "cli" / path.name).read_bytes()
    assert result.export("csv") == result.directory / "csv" / "motion.csv"
    table = tmp_path / "arm.csv"
    assert result.export("csv", table, frames=3) == table and table.read_bytes() == (tmp_path / "csv" / "motion.csv").read_bytes()
    assert result.export("svg", tmp_path / "arm.svg").read_text().startswith("<svg")
    # A file of one's own stays.
    table.write_text("mine")
    (tmp_path / "csv" / "motion.csv").write_text("mine")
    for path in (table, tmp_path / "csv"):
        with pytest.raises(sa.ResultError):
            result.export("csv", path)
    assert table.read_text() == (tmp_path / "csv" / "motion.csv").read_text() == "mine"
    for path in (table, tmp_path / "csv"):
        result.export("csv", path, force=True)
    assert table.read_text() == (tmp_path / "csv" / "motion.csv").read_text() != "mine"
    with pytest.raises(ValueError, match="format = 'png'"):
        result.export("png")


def test_a_motion_is_a_film(tmp_path):
    image = pytest.importorskip("PIL.Image")
    pytest.importorskip("matplotlib")
    result = sa.Scene.load("swing").replace({"rod.elements": 4, "time.end_s": 0.05}).simulate()
    path = result.export("gif", tmp_path / "arm.gif", frames=5, seconds=1.0, size=(201, 160))
    with image.open(path) as film:
        assert film.n_frames == 5 and film.size == (200, 160) and film.info["duration"] == 200
        first = np.asarray(film.convert("RGB"), dtype=int)
        film.seek(4)
        assert np.abs(np.asarray(film.convert("RGB"), dtype=int) - first).max() > 50
    with pytest.raises(sa.ResultError, match="force"):
        result.export("gif", path)
    assert result.export("gif", path, frames=3, size=(160, 160), force=True) == path
    assert sorted(own.name for own in tmp_path.iterdir()) == ["arm.gif"]
    for wrong in ({"frames": 1}, {"seconds": 0.0}, {"size": (10, 10)}):
        with pytest.raises(ValueError):
            result.export("gif", tmp_path / "other.gif", **wrong)


def test_a_film_in_mp4_is_made_by_ffmpeg(tmp_path, monkeypatch):
    """Without the program the error names it, and no file is left; with one it gets all frames, and its failure is told."""
    pytest.importorskip("matplotlib")
    result = sa.Scene.load("swing").replace({"rod.elements": 4, "time.end_s": 0.05}).simulate()
    monkeypatch.setenv("PATH", str(tmp_path / "bin"))
    with pytest.raises(sa.ResultError, match="ffmpeg"):
        result.export("mp4", tmp_path / "arm.mp4")
    if sys.platform == "win32":
        return
    # In its place, a program that keeps what it gets.
    (tmp_path / "bin").mkdir()
    own = tmp_path / "bin" / "ffmpeg"
    own.write_text(f"#!{sys.executable}\nimport sys\nopen(sys.argv[-1], 'wb').write(sys.stdin.buffer.read())\n")
    own.chmod(0o755)
    path = result.export("mp4", tmp_path / "arm.mp4", frames=4, size=(100, 80))
    assert path.stat().st_size == 4 * 100 * 80 * 3
    own.write_text(f"#!{sys.executable}\nimport sys\nsys.exit('no such codec')\n")
    with pytest.raises(sa.ResultError, match="code 1: no such codec"):
        result.export("mp4", tmp_path / "other.mp4", frames=4, size=(100, 80))
    assert not (tmp_path / "other.mp4").exists()


def test_a_plot_is_whole():
    """Legend, title and names of the axes are within the figure, so that a saved picture has them."""
    matplotlib = pytest.importorskip("matplotlib")
    matplotlib.use("agg")
    import matplotlib.pyplot as plt

    motion = sa.Scene.load("swing").replace({"rod.elements": 4}).simulate()
    axes = motion.plot()
    axes.figure.canvas.draw()
    parts = [axes.get_legend(), axes.title, *(axis.label for axis in (axes.xaxis, axes.yaxis, axes.zaxis))]
    for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
        low, high = sorted(axis.get_view_interval())
        parts += [tick.label1 for tick in axis.get_major_ticks() if low <= tick.get_loc() <= high]
    whole = axes.figure.bbox
    for part in parts:
        box = part.get_window_extent()
        assert whole.x0 <= box.x0 and box.x1 <= whole.x1 and whole.y0 <= box.y0 and box.y1 <= whole.y1, part
    plt.close(axes.figure)
    # In axes of one's own the legend is in these.
    own = motion.plot(plt.figure().add_subplot(projection="3d"))
    own.figure.canvas.draw()
    box, whole = own.get_legend().get_window_extent(), own.bbox
    assert whole.x0 <= box.x0 and box.x1 <= whole.x1 and whole.y0 <= box.y0 and box.y1 <= whole.y1
    plt.close(own.figure)


def test_a_name_is_no_text_of_a_scene(tmp_path):
    """The error says who reads names; a text with a fault keeps the error of the fault."""
    for name in ("reach", "x.toml", "folder/x.toml", tmp_path / "x.toml"):
        with pytest.raises(sa.SceneError, match=r"Scene\.load\(.*reads files"):
            sa.Scene(name)
    with pytest.raises(sa.SceneError, match="rod"):
        sa.Scene("[rod]")


def test_profiles_come_from_tables(tmp_path):
    """A CSV file, an array, a DataFrame and a dictionary give the same rows; NaN and empty fields are gaps, across which it is linear."""
    rows = [[0.0, 0.0], [0.25, 1.0], [1.0, 2.0]]
    array = np.array([[0.0, 0.0], [0.25, 1.0], [0.5, np.nan], [1.0, 2.0], [1.5, np.nan]])
    plain, headed = tmp_path / "plain.csv", tmp_path / "headed.csv"
    plain.write_text("0,0\n0.25,1\n0.5,\n1.0,2\n1.5,nan\n")
    headed.write_text("left (N),t_s,note\n0,0,1\n1,0.25,1\n,0.5,1\n2,1.0,1\nnan,1.5,1\n")
    columns = {"t": array[:, 0], "left": array[:, 1]}
    for source in (array, array.tolist(), plain, str(plain), columns):
        assert sa.profile(source) == rows
    assert sa.profile(headed, ["t_s", "left (N)"]) == sa.profile(headed, [1, 0]) == rows
    scene = sa.Scene(WINCH).replace({"tendon.1.tension_n": None, "tendon.1.profile": array})
    assert scene["tendon.1.profile"] == rows and scene == scene.replace({"tendon.1.profile": plain})
    keys = scene.to_dict()
    keys["tendon"][1]["profile"] = str(plain)
    keys["load"] = [{"node": "tip", "force_n": [0.1, 0.0, 0.0], "profile": columns}]
    scene = sa.Scene(keys)
    assert scene["tendon.1.profile"] == scene["load.0.profile"] == rows
    plant = scene.plant()
    plant.step(0.5)
    assert plant.efforts["other"] == pytest.approx(1.0 + 0.25 / 0.75)
    for wrong, words in (
        ([[np.nan, 1.0]], "time"),
        ([[0.0, np.nan]], "without any"),
        ([[0.0]], "at least one"),
        ([0.0, 1.0], "shape"),
        ({"t": [0.0], "a": [0.0, 1.0]}, "lengths"),
    ):
        with pytest.raises(ValueError, match=words):
            sa.profile(wrong)
    with pytest.raises(ValueError, match="no column 'right'"):
        sa.profile(headed, ["t_s", "right"])
    plain.write_text("0,0\n1,x\n")
    with pytest.raises(ValueError, match="row 2 has 'x'"):
        sa.profile(plain)
    with pytest.raises(sa.SceneError):
        scene.replace({"tendon.1.profile": [[1.0, 0.0], [0.5, 0.0]]})


def test_profiles_come_from_pandas():
    pandas = pytest.importorskip("pandas")
    frame = pandas.DataFrame({"t_s": [0.0, 0.5, 1.0], "left": [1.0, None, 2.0], "right": [0.0, 1.0, 3.0]})
    assert sa.profile(frame, ["t_s", "left"]) == [[0.0, 1.0], [1.0, 2.0]]
    assert sa.profile(frame) == [[0.0, 1.0, 0.0], [1.0, 2.0, 3.0]]
    assert sa.profile(frame.set_index("t_s")["left"]) == [[0.0, 1.0], [1.0, 2.0]]


def test_plants_are_pickled():
    """A plant of a loop, with a command that still acts, goes on to the bit."""
    scene = sa.Scene.load("mpc-tendons").replace({"estimator.kind": "none", "estimator.disturbances": [], "sensor": []})
    controller, plant = scene.controller(), scene.plant()
    commands = []
    for _ in range(3):
        commands.append(controller.step(plant.state_on(controller)))
        plant.apply(commands[-1])
    others = [pickle.loads(pickle.dumps(plant)), copy.deepcopy(plant)]
    command = controller.step(plant.state_on(controller))
    for other in others:
        assert other.efforts == plant.efforts and other.time == plant.time
    for arm in (plant, *others):
        arm.apply(command)
        arm.step(0.01)
    for other in others:
        assert all(np.array_equal(a, b) for a, b in zip(other.state, plant.state))


def test_batches_are_pickled_and_changed():
    scene = sa.Scene.load("swing")
    arms = sa.batch(scene, 3, each={"rod.material.density_kg_m3": [900.0, 1000.0, 1100.0]})
    arms.change(1, ["rod.material.youngs_modulus_pa=5e5"])
    arms.step(0.02)
    others = [pickle.loads(pickle.dumps(arms)), copy.deepcopy(arms), copy.copy(arms)]
    arms.step(0.02)
    for other in others:
        other.step(0.02)
        assert np.array_equal(other.positions, arms.positions) and np.array_equal(other.times, arms.times)
    plant = scene.replace({"rod.material.density_kg_m3": 1000.0, "rod.material.youngs_modulus_pa": 5e5}).plant()
    plant.step(0.02), plant.step(0.02)
    assert np.array_equal(arms.state(1).x, plant.state.x)
    # A change holds until the next one, and does not go away by a reset.
    arms.reset()
    plant.reset()
    arms.step(0.02), plant.step(0.02)
    assert np.array_equal(arms.state(1).x, plant.state.x)
    before = arms.positions
    with pytest.raises(ValueError, match="nodes"):
        arms.change(0, ["rod.elements=3"])
    with pytest.raises(sa.SceneError):
        arms.change(0, ["rod.elemens=3"])
    with pytest.raises(IndexError):
        arms.change(3, [])
    assert np.array_equal(arms.positions, before)


def test_a_plant_is_the_simulation():
    scene = sa.Scene.load("swing").replace(SHORT)
    result = scene.simulate()
    plant = scene.plant()
    state = plant.step(0.05)
    scale = scene["rod.length_m"]
    assert np.abs(state.x - result.x[-1]).max() < 1e-12 * scale
    assert plant.time == pytest.approx(0.05)
    # The same steps in two calls, and from a copy.
    plant.reset()
    steps = round(0.05 / plant.longest_step)
    plant.step(20 * plant.longest_step)
    other = copy.copy(plant)
    for arm in (plant, other):
        state = arm.step((steps - 20) * plant.longest_step)
        assert np.abs(state.x - result.x[-1]).max() < 1e-12 * scale
    third = scene.plant()
    third.set_state(plant.state, time=plant.time)
    assert np.allclose(third.step(0.01).x, plant.step(0.01).x, rtol=0, atol=1e-10 * scale)


def test_work_of_a_force_is_energy():
    """An undamped arm: the energy that it gains is the work of the force on its tip."""
    plant = sa.Scene(sa.arm(0.3, 0.01, 1e6, elements=8, gravity=False) | {"time": {"end_s": 1.0}}).plant()
    wrenches = np.zeros((9, 6))
    wrenches[-1, 0] = 0.05
    before, work = sum(plant.energy.values()), 0.0
    for _ in range(100):
        tip = plant.tip
        plant.step(1e-3, wrenches)
        work += 0.05 * (plant.tip[0] - tip[0])
    gained = sum(plant.energy.values()) - before
    # The energy of a variational integrator is off by the square of the step.
    assert work > 1e-4 and gained == pytest.approx(work, rel=2e-2)


def test_a_loop_in_python_with_a_plant_of_other_elements():
    """The model has 10 elements and the plant 40: the tip is within 2 % of the length of its reference after a second."""
    scene = sa.Scene.load("mpc-track-circle").replace({"mpc.duration_s": 1.0})
    controller, plant = scene.controller(), scene.plant()
    assert len(controller.places) != len(plant.places)
    begun, took = time.perf_counter(), 0.0
    while plant.time < 1.0 - 1e-9:
        command = controller.step(plant.state_on(controller))
        took += command.seconds
        plant.apply(command)
    assert 0.0 < took < time.perf_counter() - begun
    tip = command.answer["tip"]
    assert np.linalg.norm(np.subtract(tip["position_m"], tip["reference_m"])) < 0.02 * scene["rod.length_m"]


def test_bad_arrays_are_refused():
    plant = sa.Scene.load("swing").plant()
    with pytest.raises(ValueError, match=r"wrenches has the shape \[3\]"):
        plant.step(0.01, [1, 2, 3])
    wrenches = np.zeros((len(plant.places), 6))
    wrenches[2, 1] = np.nan
    with pytest.raises(ValueError, match="entry 13"):
        plant.step(0.01, wrenches)
    with pytest.raises(ValueError, match="dt"):
        plant.step(-1.0)
    with pytest.raises(ValueError, match="rotation"):
        plant.set_state((plant.state.x, 2 * plant.state.R))
    with pytest.raises(sa.ModelError):
        plant.step(0.1, 1e9 * np.ones_like(wrenches))
    plant.reset()
    plant.step(0.01)


def test_tensions_move_a_plant():
    scene = sa.Scene.load("mpc-tendons")
    plant = scene.plant()
    assert len(plant.actuators) == 4
    pulled = scene.plant()
    zero = plant.step(0.2, efforts=np.zeros(4)).x[-1]
    tip = pulled.step(0.2, efforts=[2.0, 0.0, 0.0, 0.0]).x[-1]
    assert np.linalg.norm(tip - zero) > 1e-3


def test_a_loop_in_python_is_the_loop_of_the_command():
    """Without sensors, and with a plant that has the model's elements, the two differ by the time step in which a command begins: the
    simulated arm of the command goes linearly to the new value within the step before, half a step early.
    """
    scene = sa.Scene.load("mpc-track-circle")
    keys = scene.to_dict()
    for section in ("plant", "sensor", "estimator", "disturbance"):
        keys.pop(section, None)
    keys["mpc"]["duration_s"] = 0.3
    scene = sa.Scene(keys)
    result = scene.mpc()
    controller, plant = scene.controller(), scene.plant()
    tips = [plant.tip]
    for _ in range(len(result.t) - 1):
        command = controller.step(plant.state_on(controller))
        assert command.fallback is None and not command.refused
        plant.apply(command)
        tips.append(plant.tip)
    speed = np.abs(np.diff(result.tip, axis=0)).max() / controller.period
    assert np.abs(np.array(tips) - result.tip).max() < plant.longest_step * speed


def test_a_faulty_measurement_is_answered():
    scene = sa.Scene.load("mpc-track-circle")
    controller = scene.controller()
    command = controller.step(positions=np.zeros((2, 3)), rotations=np.tile(np.eye(3), (len(controller.places), 1, 1)))
    assert command.refused[0]["where"] == "positions_m" and command.end > command.start
    with pytest.raises(ValueError, match=r"expected \[11, 3\]"):
        controller.step(positions=np.zeros((3, 11)), rotations=np.tile(np.eye(3), (11, 1, 1)))
    with pytest.raises(ValueError, match="rows"):
        controller.step(reference=[[0.0, 0.0, 1.0]])


def test_references_turn_and_advice_is_told():
    scene = sa.Scene.load("mpc-reach")
    turned = [[0.0, 1.0, 0.0, 0.0, 0.0]]

    def refused(scene):
        controller, plant = scene.controller(), scene.plant()
        command = controller.step(plant.state_on(controller), reference_wxyz=turned)
        return [own["message"] for own in command.refused if own["where"].startswith("reference_wxyz")]

    assert ["an orientation" in message for message in refused(scene)] == [True]
    assert refused(scene.replace({"task.orientation_wxyz": [1.0, 0.0, 0.0, 0.0]})) == []
    controller, plant = scene.controller(), scene.plant()
    command = controller.step(plant.state_on(controller))
    assert command.advice == []
    with pytest.raises(ValueError, match="rows"):
        controller.step(plant.state_on(controller), reference_wxyz=[[0.0, 1.0]])


def test_measurements_that_cannot_be_are_left_out():
    """NaN and millimeters in the place of meters: a loop goes on with what is left, and says what it left out."""
    scene = sa.Scene.load("mpc-track-circle").replace({"estimator.kind": "none", "estimator.disturbances": []})
    controller, plant = scene.controller(), scene.plant()
    state = plant.state_on(controller)
    x = state.x.copy()
    x[4, 1] = np.nan
    for positions, words in ((x, "not finite"), (1e3 * state.x, "away from the clamp")):
        command = controller.step(positions=positions, rotations=state.R)
        assert command.fallback and words in command.refused[0]["message"]
    controller.reset()
    assert controller.next_time == 0.0 and controller.step((state.x, state.R)).fallback is None
    # An estimator takes the other markers, and notes a jump of one.
    seen = sa.Scene.load("mpc-track-circle").controller()
    markers = [{"place": place, "position_m": plant.state.x[int(40 * place)].copy()} for place in (0.5, 0.75, 1.0)]
    markers[1]["position_m"][2] = np.nan
    command = seen.step(readings=markers)
    assert command.refused[0]["where"] == "readings[1].position_m" and command.fallback is None
    markers[1]["position_m"][2] = 100.0
    assert "away from the clamp" in seen.step(readings=markers).refused[0]["message"]


def test_a_disturbance_may_come_from_outside():
    """A plant with a payload that the caller knows: the model with it predicts the tip better than without; what cannot be is left out."""
    scene = sa.Scene.load("mpc-payload").replace({"estimator.kind": "none", "estimator.disturbances": [], "mpc.computing": "none"})
    off = []
    for given in (None, {"payload_kg": 0.05}):
        controller, plant = scene.controller(), scene.plant()
        for k in range(20):
            command = controller.step(plant.state_on(controller), disturbance=given)
            assert not command.refused
            plant.apply(command)
        off.append(np.linalg.norm(plant.state.x[-1] - command.answer["predicted_tip_m"]))
    assert off[1] < 0.5 * off[0], off
    refused = controller.step(plant.state_on(controller), disturbance={"payload_kg": np.nan}).refused
    assert refused[0]["where"] == "disturbance.payload_kg"
    refused = controller.step(plant.state_on(controller), disturbance={"stiffness_factor": 9.0}).refused
    assert refused[0]["where"] == "disturbance.stiffness_factor"


def test_keys_are_taken_away():
    scene = sa.Scene.load("mpc-tendons")
    with pytest.raises(KeyError, match="no key of this scene"):
        scene.replace({"rod.elemens": None})
    given = scene.replace({"damping.viscous_1_s": 3.0})
    assert given.replace({"damping.viscous_1_s": None})["damping.viscous_1_s"] == 0.0


def test_simulations_tell_their_progress(capsys):
    told = []
    sa.Scene.load("swing").replace(SHORT).simulate(on_event=told.append)
    assert told[-1]["step"] == told[-1]["steps"] and [own["event"] for own in told] == ["progress"] * len(told)
    listen = sa.progress(every=0.0)
    for event in told:
        listen(event)
    assert "step" in capsys.readouterr().err



def test_many_arms_move_like_one():
    """Calls are long enough for two threads."""
    scene = sa.Scene.load("swing")
    arms = sa.batch(scene, 5, threads=2)
    wrenches = np.zeros((5, 6))
    wrenches[:, 0] = np.linspace(0.0, 0.4, 5)
    for _ in range(3):
        assert arms.step(0.1, wrenches) == [None] * 5
    alone = scene.plant()
    own = np.zeros((len(alone.places), 6))
    own[-1] = wrenches[3]
    for _ in range(3):
        alone.step(0.1, own)
    assert np.array_equal(arms.positions[3], alone.state.x)
    # One arm breaks down; the others go on, and it returns by a reset.
    wrenches[1] = 1e9
    errors = arms.step(0.05, wrenches)
    assert errors[1] and [error for i, error in enumerate(errors) if i != 1] == [None] * 4
    arms.reset([1])
    assert arms.step(0.01) == [None] * 5
    with pytest.raises(IndexError):
        arms.reset([5])


def partial_after_an_interrupt(verb):
    """Sends SIGINT to a verb after its first event, and returns the result that it leaves."""
    begun = threading.Event()

    def interrupt():
        begun.wait(60)
        signal.raise_signal(signal.SIGINT)

    thread = threading.Thread(target=interrupt)
    thread.start()
    with pytest.raises(KeyboardInterrupt) as caught:
        verb(on_event=lambda event: begun.set())
    thread.join()
    return caught.value.partial


def test_an_interrupt_ends_a_solve_with_its_partial_result():
    scene = sa.Scene.load("reach-3d").replace({"rod.elements": 60, "task.at_rest": False})
    assert partial_after_an_interrupt(scene.solve).status == "interrupted"


def interrupted_after(seconds, work):
    """Sends SIGINT to a work after some seconds."""
    timer = threading.Timer(seconds, signal.raise_signal, [signal.SIGINT])
    timer.start()
    with pytest.raises(KeyboardInterrupt):
        work()
    timer.join()


def test_an_interrupt_ends_a_loop_with_its_partial_result():
    partial = partial_after_an_interrupt(sa.Scene.load("mpc-push").mpc)
    assert partial.status == "interrupted" and len(partial.table("samples.csv")) > 0


@pytest.mark.parametrize("threads", [1, 2])
def test_an_interrupt_ends_a_batch(threads):
    """Arms under a call of hours stay where they were, and move on afterwards."""
    arms = sa.batch(sa.Scene.load("swing"), 4, threads=threads)
    before = arms.positions
    interrupted_after(0.2, lambda: arms.step(1e4))
    assert np.array_equal(arms.positions, before) and (arms.times == 0.0).all()
    assert arms.step(0.01) == [None] * 4


def test_an_interrupt_ends_a_plant():
    plant = sa.Scene.load("swing").plant()
    before = plant.state.x
    interrupted_after(0.2, lambda: plant.step(1e4))
    assert np.array_equal(plant.state.x, before) and plant.time == 0.0


def test_arms_of_a_batch_with_values_of_their_own():
    """Every arm moves as a plant of its own scene does, from a start of its own."""
    key = "rod.material.youngs_modulus_pa"
    scene, moduli = sa.Scene.load("swing"), [8e5, 1e6, 2e6]
    arms = sa.batch(scene, 3, each={key: moduli}, threads=2)
    for index, modulus in enumerate(moduli):
        alone = scene.replace({key: modulus}).plant()
        state = alone.state
        # The base stays where it is clamped.
        moved = (state.x + np.outer(alone.places**2, [0.0, 0.1 * index, 0.0]), state.R)
        alone.set_state(moved)
        arms.set_state(index, *moved)
        alone.step(0.1)
        arms.step(0.1)
        assert np.array_equal(alone.state.x, arms.positions[index])
        arms.reset()
    assert arms.step(0.1) == [None] * 3
    with pytest.raises(ValueError, match="each of the 3 arms"):
        sa.batch(scene, 3, each={key: [1e6]})
    with pytest.raises(ValueError, match="as many nodes"):
        sa.batch(scene, 2, each={"rod.elements": [4, 5]})


def test_exceptions_of_listeners_end_the_work():
    def fail(event):
        raise RuntimeError("enough")

    with pytest.raises(RuntimeError, match="enough"):
        sa.Scene.load("reach").solve(on_event=fail)


def test_two_solves_run_at_once():
    """Two threads solve at the same time: each sees iterations of the other between its own."""
    order = []
    scene = sa.Scene.load("reach")

    def solve(number):
        scene.solve(on_event=lambda event: order.append(number))

    threads = [threading.Thread(target=solve, args=(number,)) for number in (1, 2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    first = [i for i, number in enumerate(order) if number == 1]
    second = [i for i, number in enumerate(order) if number == 2]
    assert first and second and first[0] < second[-1] and second[0] < first[-1]


def test_tasks_of_a_sweep(tmp_path):
    task = {"verb": "simulate", "scene": "swing", "set": SHORT}
    assert pickle.loads(pickle.dumps(task)) == task
    first = sa.run(task, tmp_path)
    again = sa.run(task, tmp_path)
    assert first["exit_code"] == 0 and again["skipped"] and again["summary"] == first["summary"]
    assert sa.run({**task, "set": {"time.end_s": 0.06}}, tmp_path)["key"] != first["key"]
    small = sa.run(task, tmp_path / "small", small=True)
    assert small["summary"]["tip"] == first["summary"]["tip"]
    assert not (tmp_path / "small" / small["key"] / "trajectory.npz").exists()
    assert "elemens" in sa.run({"scene": "swing", "set": {"rod.elemens": 1}})["error"]
    with pytest.raises(ValueError):
        sa.run({"scene": "swing", "verbs": "solve"})


def test_short_ways():
    keys = sa.arm(0.3, 0.01, 1e6) | sa.reach([0.1, 0.0, -0.25], 0.6, 0.5, at_rest=False)
    assert sa.Scene(keys).solve().certificate
    eight = sa.arm(0.3, 0.01, 1e6, elements=8, damping=1.0) | sa.figure_eight([0.0, 0.0, -0.29], 0.02, 2.0, duration=0.1, force_max=1.0)
    assert sa.Scene(eight).mpc().status == "completed"


def test_a_check_says_what_follows():
    summary = sa.Scene.load("reach").check()
    assert summary["command"] == "check" and summary["mass_kg"] > 0


def test_memory_of_many_steps():
    """A controller and a plant keep their memory: 20 000 steps do not grow it by more than a megabyte."""
    resource = pytest.importorskip("resource")
    scene = sa.Scene.load("swing").replace({"rod.elements": 6})
    plant = scene.plant()
    plant.step(1e-3)

    def steps(n):
        for _ in range(n):
            plant.step(1e-4)
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss

    before = steps(2_000)
    assert steps(20_000) - before < 1024


def test_published_shapes_are_fitted():
    """SoRoMoX' shapes: an independent program fitted 3.745e5 Pa +- 1.3 % and 1162 kg/m^3 +- 2.9 % to them."""
    data = Path(__file__).parents[2] / "examples" / "data" / "soromox-shapes.toml"
    keys = ["rod.material.youngs_modulus_pa", "rod.material.density_kg_m3"]
    result = sa.Scene.load("soromox-tendons").fit(data, keys)
    modulus, density = (own["value"] for own in result.summary["parameters"])
    assert modulus == pytest.approx(3.745e5, rel=0.5 * 0.013) and density == pytest.approx(1162, rel=0.5 * 0.029)
    assert result.scene["rod.material.density_kg_m3"] == density
    assert result.x.shape[:2] == (8, 16) and "m1 at 7.6923 N" in result._repr_html_()
    with pytest.raises(sa.ResultError, match="no number"):
        sa.Scene.load("soromox-tendons").fit(data, ["rod.material.youngs"])


def test_texts_beyond_the_basic_plane_and_control_characters():
    """TOML has no surrogate pairs, and escapes U+007F: names with either come back as they are."""
    keys = sa.Scene.load("reach-tendons").to_dict()
    for name in ("\U0001f419", "a\x7fb", 'quote " and \\', "tab\tand é"):
        keys["tendon"][0]["name"] = name
        assert sa.Scene(keys)["tendon.0.name"] == name


def test_a_forked_process_leaves_the_files_of_a_result():
    """The folder of a result goes with the process that made it, and not with a child that drops its copy."""
    result = sa.Scene.load("swing").replace({"rod.elements": 3, "time.end_s": 0.02}).simulate()
    if (child := os.fork()) == 0:
        del result
        gc.collect()
        os._exit(0)
    os.waitpid(child, 0)
    assert result.x.ndim == 3
    folder = result.directory
    del result
    gc.collect()
    assert not folder.exists()


def test_complex_numbers_are_refused():
    """An imaginary part would be lost in silence."""
    plant = sa.Scene.load("swing").replace({"rod.elements": 3}).plant()
    with pytest.raises(ValueError, match="complex"):
        plant.set_state((plant.state[0] + 0j, plant.state[1]))


def test_a_scene_may_be_named_like_an_option():
    """A name that begins with a dash is a name."""
    scene = sa.Scene(sa.Scene.load("swing").to_dict(), name="--help")
    assert scene.check()


def test_a_stopped_solve_has_a_repr():
    """A solve that its deadline ends before the check has no tip error, and its repr says what there is."""
    result = sa.Scene.load("reach").replace({"rod.elements": 30, "solver.deadline_s": 0.3}).solve()
    assert result.status in repr(result)


def test_messages_name_arguments(tmp_path):
    """Errors of a verb name the arguments of Python, and not the options of the command line, nor its usage."""
    scene = sa.Scene.load("swing")
    with pytest.raises(ValueError, match="budget") as refused:
        scene.tradeoff(budget="1x")
    assert "--" not in str(refused.value) and "Usage" not in str(refused.value)
    file = tmp_path / "file"
    file.write_text("mine")
    with pytest.raises(sa.ResultError, match="choose another out$"):
        scene.simulate(out=file)
    assert file.read_text() == "mine"
