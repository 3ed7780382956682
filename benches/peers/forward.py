"""Forward simulation beside peers: error of the tip against time, all in one run.

    cargo build --release
    python3.11 -m venv venv && venv/bin/pip install numpy matplotlib pyelastica exudyn mujoco
    venv/bin/python benches/peers/forward.py [--picture forward.png] [--repeat 3] [--only softarm,pyelastica,exudyn,mujoco]

A soft arm, 1 m long, is clamped at its base, upright and straight, without gravity and damping. A force of 5 N pulls its tip aside from one moment to the
next; the motion is followed for one second. All programs have the same length, radius, density, Young's modulus, Poisson's ratio and shear factor (27/28, which
PyElastica uses). The error is the largest distance of the tip from the reference at fifty times, over the largest deflection of the tip. The reference is
softarm with 160 elements; its distance from the finest Exudyn run is printed, because neither program knows of the other.

MuJoCo has no rods: it gets rigid cylinders with ball joints between them, whose springs are those of an element's bending (its own cable bends in the same
way). The first and the last cylinder are half as long, so that the clamp is in the middle of a joint's part of the arm; it neither stretches nor shears, which a real
rod does, so that its error has a floor. Its integrator is that of Runge and Kutta, at two thirds of the largest stable step, and at least twice between two of the
fifty times.

Times are those of the steps alone, in one thread: of softarm by the field node_steps_per_s of its summary, of PyElastica the loop of steps after the first call has
compiled them, of Exudyn the call of its solver, of MuJoCo the calls of mj_step. Of softarm the whole process, with start and
files, is printed as well. Least of the repeats.
"""

import argparse
import json
import os
import subprocess
import tempfile
import time
import tomllib
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("NUMBA_NUM_THREADS", "1")

import numpy as np

SCENE = Path(__file__).parent / "scenes" / "forward.toml"
READ = tomllib.loads(SCENE.read_text())
ROD, MATERIAL = READ["rod"], READ["rod"]["material"]
LENGTH, RADIUS = ROD["length_m"], ROD["section"]["radius_m"]
YOUNGS, POISSON, DENSITY, SHEAR = (MATERIAL[key] for key in ("youngs_modulus_pa", "poisson_ratio", "density_kg_m3", "shear_factor"))
FORCE, DURATION = READ["load"][0]["force_n"][0], READ["time"]["end_s"]
TIMES = round(DURATION * READ["output"]["rate_hz"])
AREA = np.pi * RADIUS**2
INERTIA = 0.25 * np.pi * RADIUS**4
SHEAR_MODULUS = YOUNGS / (2.0 * (1.0 + POISSON))


def softarm(program, elements):
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "run"
        command = [program, "simulate", str(SCENE), "--out", str(out), "--set", f"rod.elements={elements}", "--threads", "1", "--json", "--quiet"]
        begun = time.perf_counter()
        summary = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
        whole = time.perf_counter() - begun
        motion = np.load(out / "trajectory.npz")
        stepping = summary["steps"] * (elements + 1) / summary["node_steps_per_s"]
        return motion["x"][:, -1, :][:, [0, 2]], stepping, whole, summary["step_s"]


def pyelastica(elements):
    import elastica as ea

    class Simulator(ea.BaseSystemCollection, ea.Constraints, ea.Forcing):
        pass

    # Its own stable step at this number of elements, with a margin: the fastest wave along an element.
    step = 0.7 * (LENGTH / elements) / np.sqrt(YOUNGS / DENSITY) * min(1.0, elements / 20)
    per_row = int(np.ceil(DURATION / TIMES / step))
    step = DURATION / TIMES / per_row
    simulator = Simulator()
    rod = ea.CosseratRod.straight_rod(
        elements, np.zeros(3), np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0]), LENGTH, RADIUS, DENSITY,
        youngs_modulus=YOUNGS, shear_modulus=SHEAR_MODULUS,
    )  # fmt: skip
    simulator.append(rod)
    simulator.constrain(rod).using(ea.OneEndFixedBC, constrained_position_idx=(0,), constrained_director_idx=(0,))
    simulator.add_forcing_to(rod).using(ea.EndpointForces, np.zeros(3), np.array([FORCE, 0.0, 0.0]), ramp_up_time=1e-12)
    simulator.finalize()
    stepper, now, tip = ea.PositionVerlet(), 0.0, [rod.position_collection[[0, 2], -1].copy()]
    seconds = 0.0
    for _ in range(TIMES):
        begun = time.perf_counter()
        for _ in range(per_row):
            now = stepper.step(simulator, now, step)
        seconds += time.perf_counter() - begun
        tip.append(rod.position_collection[[0, 2], -1].copy())
    return np.array(tip), seconds, None, step


def exudyn(elements, step):
    import exudyn as exu
    import exudyn.itemInterface as items

    container = exu.SystemContainer()
    system = container.AddSystem()
    section = exu.BeamSection()
    section.stiffnessMatrix = np.diag(
        [YOUNGS * AREA, SHEAR * SHEAR_MODULUS * AREA, SHEAR * SHEAR_MODULUS * AREA, 2 * SHEAR_MODULUS * INERTIA, YOUNGS * INERTIA, YOUNGS * INERTIA]
    )
    section.inertia = DENSITY * np.diag([2 * INERTIA, INERTIA, INERTIA])
    section.massPerLength = DENSITY * AREA
    nodes = [
        system.AddNode(items.NodeRigidBodyRotVecLG(referenceCoordinates=[LENGTH * q / elements, 0, 0, 0, 0, 0])) for q in range(elements + 1)
    ]
    for q in range(elements):
        system.AddObject(
            items.ObjectBeamGeometricallyExact(nodeNumbers=[nodes[q], nodes[q + 1]], length=LENGTH / elements, sectionData=section)
        )
    ground = system.AddObject(items.ObjectGround())
    held = system.AddMarker(items.MarkerBodyRigid(bodyNumber=ground, localPosition=[0, 0, 0]))
    base = system.AddMarker(items.MarkerNodeRigid(nodeNumber=nodes[0]))
    system.AddObject(items.GenericJoint(markerNumbers=[held, base], constrainedAxes=[1] * 6))
    tip = system.AddMarker(items.MarkerNodeRigid(nodeNumber=nodes[-1]))
    system.AddLoad(items.LoadForceVector(markerNumber=tip, loadVector=[0, FORCE, 0]))
    sensor = system.AddSensor(items.SensorNode(nodeNumber=nodes[-1], storeInternal=True, outputVariableType=exu.OutputVariableType.Position))
    system.Assemble()
    settings = exu.SimulationSettings()
    settings.timeIntegration.endTime = DURATION
    settings.timeIntegration.numberOfSteps = round(DURATION / step)
    settings.timeIntegration.verboseMode = 0
    settings.solution.file.write = False
    settings.solution.sensors.writePeriod = step
    settings.linearSolver.solverType = exu.LinearSolverType.EigenSparse
    settings.timeIntegration.newton.useModifiedNewton = True
    begun = time.perf_counter()
    system.SolveDynamic(settings, solverType=exu.DynamicSolverType.TrapezoidalIndex2)
    seconds = time.perf_counter() - begun
    found = system.GetSensorStoredData(sensor)
    times = np.linspace(0.0, DURATION, TIMES + 1)
    # Its axis is x and its side y; here they are z and x.
    return np.array([np.interp(times, found[:, 0], found[:, axis]) for axis in (2, 1)]).T, seconds, None, step


def mujoco(elements):
    import mujoco as mj

    def cylinder(start, end):
        return f'<geom type="cylinder" size="{RADIUS}" fromto="0 0 {start} 0 0 {end}" density="{DENSITY}"/>'

    part = LENGTH / elements
    stiffness = YOUNGS * INERTIA / part
    inner = f'<body pos="0 0 {0.5 * part}"><joint type="ball" stiffness="{stiffness}"/>'
    for _ in range(elements - 1):
        inner += cylinder(0, part) + f'<body pos="0 0 {part}"><joint type="ball" stiffness="{stiffness}"/>'
    inner += cylinder(0, 0.5 * part) + f'<site name="tip" pos="0 0 {0.5 * part}"/>' + "</body>" * elements
    fastest = 4.0 * np.sqrt(YOUNGS * INERTIA / (DENSITY * AREA)) / part**2
    per_row = max(2, int(np.ceil(DURATION / TIMES / (2.0 / 3.0 * 2.8 / fastest))))
    step = DURATION / TIMES / per_row
    model = mj.MjModel.from_xml_string(f"""
<mujoco>
  <option gravity="0 0 0" timestep="{step!r}" integrator="RK4"><flag contact="disable" constraint="disable"/></option>
  <worldbody><site name="world"/>{inner}</worldbody>
  <actuator><general site="tip" refsite="world" gear="1 0 0 0 0 0"/></actuator>
</mujoco>""")
    data = mj.MjData(model)
    data.ctrl[0] = FORCE
    site = mj.mj_name2id(model, mj.mjtObj.mjOBJ_SITE, "tip")
    mj.mj_forward(model, data)
    tip, seconds = [data.site_xpos[site][[0, 2]].copy()], 0.0
    for _ in range(TIMES):
        begun = time.perf_counter()
        mj.mj_step(model, data, per_row)
        seconds += time.perf_counter() - begun
        mj.mj_kinematics(model, data)
        tip.append(data.site_xpos[site][[0, 2]].copy())
    return np.array(tip), seconds, None, step


def least(run, repeat):
    """The run with the least time; slow ones are made once."""
    best = run()
    for _ in range(repeat - 1 if best[1] < 5.0 else 0):
        again = run()
        best = again if again[1] < best[1] else best
    return best


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--picture", type=Path)
    parser.add_argument("--repeat", type=int, default=3)
    parser.add_argument("--softarm", default=str(Path(__file__).resolve().parents[2] / "target/release/softarm"))
    parser.add_argument("--only", default="softarm,pyelastica,exudyn,mujoco")
    options = parser.parse_args()
    wanted = options.only.split(",")
    rows = []
    reference = softarm(options.softarm, 160)[0]
    deflection = np.linalg.norm(reference - reference[0], axis=1).max()

    def add(name, elements, run):
        tip, seconds, whole, step = least(run, options.repeat)
        if len(tip) != TIMES + 1:
            print(f"{name} with {elements} elements: {len(tip)} times, not {TIMES + 1}")
            return
        error = np.linalg.norm(tip - reference, axis=1).max() / deflection
        rows.append((name, elements, step, error, seconds, whole))
        whole_words = f"  {1e3 * whole:9.1f} ms the process" if whole else ""
        print(f"{name:11} {elements:4} elements  step {1e3 * step:8.4f} ms  error {100 * error:8.4f} %  {1e3 * seconds:10.2f} ms{whole_words}", flush=True)

    if "softarm" in wanted:
        for elements in [3, 4, 6, 8, 10, 14, 20, 28, 40, 60]:
            add("softarm", elements, lambda: softarm(options.softarm, elements))
    if "exudyn" in wanted:
        for elements, step in [(4, 0.02), (6, 0.01), (10, 0.01), (16, 0.004), (24, 0.002), (40, 0.001), (64, 0.0005)]:
            add("Exudyn", elements, lambda: exudyn(elements, step))
    if "mujoco" in wanted:
        for elements in [4, 6, 10, 14, 20, 30, 40]:
            add("MuJoCo", elements, lambda: mujoco(elements))
    if "pyelastica" in wanted:
        pyelastica(10)  # compiles
        for elements in [10, 20, 40, 80, 160, 320]:
            add("PyElastica", elements, lambda: pyelastica(elements))

    print("\n| largest error, % of the deflection | program | elements | time, ms | times that of softarm |\n|---|---|---|---|---|")
    for bound in (0.05, 0.01, 0.001):
        fastest = {}
        for name, elements, _, error, seconds, _ in rows:
            if error <= bound and seconds < fastest.get(name, (np.inf,))[0]:
                fastest[name] = (seconds, elements)
        for name in dict.fromkeys(row[0] for row in rows):
            if name not in fastest:
                print(f"| {100 * bound:g} | {name} | not reached | | |")
                continue
            seconds, elements = fastest[name]
            ratio = seconds / fastest["softarm"][0] if "softarm" in fastest else float("nan")
            print(f"| {100 * bound:g} | {name} | {elements} | {1e3 * seconds:.2f} | {ratio:.3g} |")
    if options.picture:
        import matplotlib

        matplotlib.use("Agg")
        import matplotlib.pyplot as plt

        figure, axes = plt.subplots(figsize=(7.5, 5), layout="constrained")
        for name in dict.fromkeys(row[0] for row in rows):
            own = [row for row in rows if row[0] == name]
            axes.loglog([100 * row[3] for row in own], [1e3 * row[4] for row in own], "o-", label=name)
            for row in own:
                axes.annotate(str(row[1]), (100 * row[3], 1e3 * row[4]), xytext=(4, 4), textcoords="offset points", fontsize=8)
        axes.set(xlabel="largest error of the tip, % of its deflection", ylabel="time of the simulation, ms (1 s of motion)")
        axes.grid(alpha=0.3, which="both")
        axes.legend()
        figure.savefig(options.picture, dpi=130)


if __name__ == "__main__":
    main()
