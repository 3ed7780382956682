//! Every key of the schema can be given, in the text of a scene and by `--set`, and arrives.

use std::collections::{BTreeMap, BTreeSet};

use serde_json::Value as Json;
use softarm::control::Continuation;
use softarm::scene::Scene;
use toml::Value;

/// Scenes that together give every key of the schema in each of its forms; a new key needs a line here. The first one is a reach with
/// material and section, the second a driven arm with stiffness and inertia, the third a free one, the fourth a reach whose
/// goals are soft, and the fifth an arm of a named material that is given by its diameters
/// and comes to rest within tolerances; then two rings, a rectangle, an arm of segments, one with stiffnesses about two
/// axes, and one with actuators in it.
const SCENES: [&[&str]; 18] = [
    &[
        "rod.length_m=1.5",
        "rod.elements=12",
        "rod.strain='helical'",
        "rod.model='standard'",
        "rod.rotary_inertia='segment'",
        "rod.material.youngs_modulus_pa=1e6",
        "rod.material.poisson_ratio=0.45",
        "rod.material.density_kg_m3=1070.0",
        "rod.material.shear_factor=0.9",
        "rod.section.radius_m=0.04",
        "rod.reference.curvature_1_m=[0.1, 0.0, -0.2]",
        "rod.reference.stretch=1.01",
        "base.kind='clamped'",
        "base.position_m=[0.1, 0.2, 0.3]",
        "base.direction=[0.0, 1.0, 0.0]",
        "base.roll_rad=0.25",
        "gravity.acceleration_m_s2=[0.0, 0.0, -9.81]",
        "damping.viscous_1_s=0.5",
        "damping.internal_s=0.001",
        "fluid.density_kg_m3=998.0",
        "fluid.normal_drag=1.1",
        "fluid.tangential_drag=0.02",
        "fluid.added_mass=0.9",
        "payload.mass_kg=0.2",
        "payload.inertia_kg_m2=[0.001, 0.002, 0.003]",
        "load.0.node='tip'",
        "load.0.force_n=[1.0, 0.0, 0.5]",
        "load.0.moment_n_m=[0.0, 0.1, 0.0]",
        "load.0.frame='body'",
        "load.0.profile=[[0.0, 0.0], [0.5, 1.0]]",
        "load.1.node=7",
        "distributed_load.0.from=0.25",
        "distributed_load.0.to=0.75",
        "distributed_load.0.force_n_per_m=[0.0, 0.2, 0.0]",
        "distributed_load.0.moment_n_m_per_m=[0.0, 0.0, 0.01]",
        "distributed_load.0.frame='body'",
        "distributed_load.0.profile=[[0.0, 1.0], [0.5, 0.0]]",
        "initial.shape='equilibrium'",
        "time.end_s=1.25",
        "time.step_s='auto'",
        "time.integrator='explicit'",
        "task.position_m=[0.5, 0.2, 0.9]",
        "task.orientation_wxyz=[1.0, 1.0, 0.0, 0.0]",
        "task.at_s=1.0",
        "task.free_duration.shortest_s=0.5",
        "task.free_duration.longest_s=2.0",
        "task.free_duration.price=3.0",
        "task.at_rest=false",
        "task.hard=true",
        "task.tolerance_m=0.001",
        "task.tolerance_rad=0.01",
        "task.via.0.at_s=0.5",
        "task.via.0.node='tip'",
        "task.via.0.position_m=[0.2, 0.2, 1.0]",
        "task.via.0.orientation_wxyz=[1.0, 0.0, 1.0, 0.0]",
        "task.via.0.hard=true",
        "task.via.0.tolerance_m=0.002",
        "task.via.0.tolerance_rad=0.02",
        "task.via.1.at_s=0.25",
        "task.via.1.node='base'",
        "task.via.1.position_m=[0.1, 0.2, 0.3]",
        "control.blocks=17",
        "control.hold='linear'",
        "control.force_max_n=2.0",
        "control.force_axes=[true, false, true]",
        "control.moment_max_n_m=0.3",
        "control.moment_axes=[true, true, false]",
        "control.force_rate_max_n_s=20.0",
        "control.moment_rate_max_n_m_s=3.0",
        "control.keep_taut=false",
        "control.actuator.0.node=6",
        "control.actuator.0.force_max_n=1.0",
        "control.actuator.0.force_axes=[false, true, true]",
        "control.actuator.0.moment_max_n_m=0.1",
        "control.actuator.0.moment_axes=[false, false, true]",
        "control.feedback.state=2.0",
        "control.feedback.input=3.0",
        "control.feedback.tolerance=0.1",
        "contact.0.name='table'",
        "contact.0.half_space.point_m=[0.0, 0.0, -1.5]",
        "contact.0.half_space.normal=[0.0, 0.0, 1.0]",
        "contact.0.penetration_m=0.001",
        "contact.0.force_n=2.5",
        "contact.0.from=0.25",
        "contact.0.to=0.75",
        "contact.1.penetration_m=0.002",
        "contact.1.sphere.center_m=[0.0, 3.0, 0.0]",
        "contact.1.sphere.radius_m=0.2",
        "contact.2.penetration_m=0.002",
        "contact.2.capsule.from_m=[3.0, 0.0, 0.0]",
        "contact.2.capsule.to_m=[3.0, 0.0, 1.0]",
        "contact.2.capsule.radius_m=0.1",
        "contact.3.penetration_m=0.002",
        "contact.3.box.center_m=[-3.0, 0.0, 0.0]",
        "contact.3.box.size_m=[0.2, 0.3, 0.4]",
        "contact.3.box.orientation_wxyz=[1.0, 0.0, 0.0, 1.0]",
        "obstacle.0.name='ball'",
        "obstacle.0.sphere.center_m=[2.0, 2.0, 2.0]",
        "obstacle.0.sphere.radius_m=0.1",
        "obstacle.0.velocity_m_s=[0.1, 0.0, 0.0]",
        "obstacle.0.margin_m=0.01",
        "obstacle.0.soft.linear=1.0",
        "obstacle.0.soft.quadratic=2.0",
        "obstacle.0.rate_hz=50.0",
        "obstacle.1.capsule.from_m=[2.0, 0.0, 0.0]",
        "obstacle.1.capsule.to_m=[2.0, 0.0, 1.0]",
        "obstacle.1.capsule.radius_m=0.1",
        "obstacle.2.half_space.point_m=[0.0, 0.0, -2.0]",
        "obstacle.2.half_space.normal=[0.0, 0.0, 1.0]",
        "obstacle.3.box.center_m=[-2.0, 0.0, 0.0]",
        "obstacle.3.box.size_m=[0.2, 0.3, 0.4]",
        "obstacle.3.box.orientation_wxyz=[1.0, 0.0, 0.0, 1.0]",
        "limit.0.name='strain'",
        "limit.0.stretch=[0.7, 1.3]",
        "limit.0.soft.linear=1.0",
        "limit.0.soft.quadratic=2.0",
        "limit.0.rate_hz=50.0",
        "limit.1.curvature_max_1_m=30.0",
        "limit.2.twist_max_1_m=20.0",
        "limit.3.speed_max_m_s=5.0",
        "limit.3.node=4",
        "limit.4.speed_max_m_s=5.0",
        "limit.4.node='tip'",
        "limit.5.speed_max_m_s=5.0",
        "limit.5.node='base'",
        "limit.6.tilt.axis=[1.0, 0.0, 0.0]",
        "limit.6.tilt.direction=[0.0, 0.0, 1.0]",
        "limit.6.tilt.max_rad=3.0",
        "objective.effort=2.0",
        "objective.rate=0.5",
        "objective.energy=0.1",
        "objective.track.0.node='tip'",
        "objective.track.0.path_m=[[0.0, 0.1, 0.2, 1.0], [1.0, 0.5, 0.2, 0.9]]",
        "objective.track.0.switches=true",
        "objective.track.0.weight=4.0",
        "objective.track.1.node=3",
        "objective.track.1.path_m=[[0.0, 0.1, 0.2, 0.5]]",
        "objective.samples=50",
        "objective.force_scale_n=2.5",
        "objective.moment_scale_n_m=0.35",
        "solver.tolerance=1e-7",
        "solver.max_iterations=70",
        "solver.saddle_gain=0.02",
        "solver.hessian='exact'",
        "solver.qp='sparse'",
        "solver.guess='rest'",
        "solver.continuation.target=3",
        "solver.deadline_s=20.0",
        "output.rate_hz=100.0",
        "output.diagnostics=true",
        "mpc.period_s=0.02",
        "mpc.horizon_s=0.4",
        "mpc.due_s=0.9",
        "mpc.block_s=0.05",
        "mpc.equal_blocks=4",
        "mpc.jump=10.0",
        "mpc.effort_from='zero'",
        "mpc.target_weight=1e5",
        "mpc.limit_price=1e3",
        "mpc.terminal_cost=true",
        "mpc.iterations=2",
        "mpc.deadline_s=0.01",
        "mpc.duration_s=1.5",
        "mpc.counted_from_s=0.5",
        "mpc.computing='fixed'",
        "mpc.computing_s=0.01",
        "mpc.actuator_delay_s=0.005",
        "mpc.predict=false",
        "mpc.compensate=false",
        "mpc.seed=3",
        "mpc.fallback.patience_s=0.2",
        "mpc.fallback.plan_samples=5",
        "mpc.fallback.damping_samples=20",
        "mpc.fallback.stop=true",
        "mpc.fallback.ramp_s=0.4",
        "mpc.fallback.hold=true",
        "mpc.fallback.damping=0.7",
        "doubt.margins=[0.001, 0.001, 0.001, 0.001, 0.001, 0.001, 0.001, 0.001, 0.001, 0.001, 0.001]",
        "doubt.number.0.key='plant.stiffness_factor'",
        "doubt.number.0.range=[0.9, 1.1]",
        "plant.elements=24",
        "plant.stiffness_factor=0.8",
        "plant.density_factor=1.1",
        "plant.viscous_1_s=0.7",
        "plant.internal_s=0.002",
        "plant.curvature_1_m=[0.1, 0.0, 0.0]",
        "plant.section.radius_m=0.041",
        "plant.payload.mass_kg=0.3",
        "plant.payload.inertia_kg_m2=[0.001, 0.002, 0.003]",
        "plant.actuator.delay_s=0.01",
        "plant.actuator.lag_s=0.02",
        "plant.actuator.force_max_n=3.0",
        "plant.actuator.moment_max_n_m=0.4",
        "plant.actuator.force_rate_max_n_s=30.0",
        "plant.actuator.moment_rate_max_n_m_s=4.0",
        "sensor.0.preset='mocap'",
        "sensor.0.places=[0.5, 1.0]",
        "sensor.0.offsets_m=[[0.0, 0.0], [0.01, -0.02]]",
        "sensor.0.position_sigma_m=0.001",
        "sensor.0.rotation_sigma_rad=0.01",
        "sensor.0.velocity_sigma_m_s=0.02",
        "sensor.0.angular_velocity_sigma_rad_s=0.03",
        "sensor.0.curvature_sigma_1_m=0.04",
        "sensor.0.strain_sigma=1e-5",
        "sensor.0.base_force_sigma_n=0.05",
        "sensor.0.base_moment_sigma_n_m=0.006",
        "sensor.0.rate_hz=150.0",
        "sensor.0.age_s=0.004",
        "estimator.kind='kalman'",
        "estimator.elements=5",
        "estimator.step_s=2e-4",
        "estimator.disturbances.0='tip_force'",
        "estimator.wrench_change_1_s=0.02",
        "disturbance.0.node='tip'",
        "disturbance.0.force_n=[1.0, 0.0, 0.5]",
        "disturbance.0.moment_n_m=[0.0, 0.1, 0.0]",
        "disturbance.0.frame='body'",
        "disturbance.0.profile=[[0.0, 0.0], [0.5, 1.0]]",
        "disturbance.1.node=7",
    ],
    &[
        "rod.length_m=1.5",
        "rod.elements=12",
        "rod.display_radius_m=0.03",
        "rod.stiffness.ea_n=1000.0",
        "rod.stiffness.ga_n=400.0",
        "rod.stiffness.ei_n_m2=1.0",
        "rod.stiffness.gj_n_m2=0.8",
        "rod.inertia.mass_kg_m=2.0",
        "rod.inertia.rotary_kg_m=[0.001, 0.001, 0.002]",
        "base.kind='driven'",
        "base.orientation_wxyz=[1.0, 0.0, 0.0, 1.0]",
        "base.motion.velocity_m_s=[0.1, 0.0, 0.0]",
        "base.motion.angular_velocity_rad_s=[0.0, 0.0, 0.5]",
        "base.motion.translation_m=[[0.0, 0.0, 0.0, 0.0], [1.0, 0.1, 0.2, 0.3]]",
        "base.motion.rotation_rad=[[0.0, 0.0, 0.0, 0.0], [1.0, 0.1, 0.2, 0.3]]",
        "base.motion.rotation_frame='body'",
        "base.motion.oscillation.0.translation_m=[0.0, 0.01, 0.0]",
        "base.motion.oscillation.0.rotation_rad=[0.0, 0.01, 0.0]",
        "base.motion.oscillation.0.frequency_hz=2.0",
        "base.motion.oscillation.0.phase_rad=0.5",
        "time.end_s=1.0",
        "time.step_s=1e-4",
    ],
    &[
        "rod.length_m=1.5",
        "rod.elements=12",
        "rod.material.youngs_modulus_pa=1e6",
        "rod.material.shear_modulus_pa=3e5",
        "rod.material.density_kg_m3=1070.0",
        "rod.section.radius_base_m=0.04",
        "rod.section.radius_tip_m=0.02",
        "base.kind='free'",
        "initial.velocity_m_s=[1.0, 0.0, 0.0]",
        "initial.angular_velocity_rad_s=[0.0, 0.0, 2.0]",
        "time.end_s=1.0",
        "plant.section.radius_base_m=0.041",
        "plant.section.radius_tip_m=0.021",
    ],
    &[
        "rod.length_m=1.5",
        "rod.elements=12",
        "rod.material.youngs_modulus_pa=1e6",
        "rod.material.poisson_ratio=0.45",
        "rod.material.density_kg_m3=1070.0",
        "rod.section.diameter_m=0.08",
        "time.end_s=1.0",
        "task.position_m=[0.5, 0.2, 0.9]",
        "task.at_rest=true",
        "task.stays_s=0.7",
        "task.stays_m=0.02",
        "task.hard=false",
        "task.weight=10.0",
        "task.via.0.at_s=0.5",
        "task.via.0.node=6",
        "task.via.0.position_m=[0.1, 0.1, 0.5]",
        "task.via.0.hard=false",
        "task.via.0.weight=5.0",
        "task.via.1.at_s=0.25",
        "task.via.1.node=0.5",
        "task.via.1.position_m=[0.1, 0.1, 0.5]",
        "load.0.node=0.25",
        "load.0.force_n=[1.0, 0.0, 0.0]",
        "limit.0.speed_max_m_s=5.0",
        "limit.0.node=0.75",
        "limit.0.from_s=0.25",
        "limit.0.to_s=0.5",
        "disturbance.0.node=0.5",
        "disturbance.0.force_n=[0.0, 1.0, 0.0]",
        "objective.track.0.node=0.5",
        "control.blocks=10",
        "control.force_max_n=[1.0, 2.0, 3.0]",
        "control.moment_max_n_m=[0.1, 0.2, 0.3]",
        "control.force_rate_max_n_s=[10.0, 20.0, 30.0]",
        "control.moment_rate_max_n_m_s=[1.0, 2.0, 3.0]",
        "control.distributed.points=6",
        "control.distributed.moment_max_n_m_per_m=[10.0, 20.0, 0.0]",
        "control.distributed.moment_scale_n_m_per_m=5.0",
        "control.actuator.0.node=6",
        "control.actuator.0.force_max_n=[1.0, 0.0, 0.0]",
        "control.actuator.0.moment_max_n_m=[0.1, 0.0, 0.0]",
        "solver.continuation.load=4",
        "doubt.plants=50",
        "doubt.seed=3",
        "doubt.share=0.1",
        "doubt.number.0.key='rod.length_m'",
        "doubt.number.0.factor=[0.9, 1.1]",
        "doubt.number.1.key='base.position_m.0'",
        "doubt.number.1.range=[-0.01, 0.01]",
        "doubt.number.2.key='rod.material.density_kg_m3'",
        "doubt.number.2.sigma=10.0",
        "doubt.correlation=[[1.0]]",
        "objective.track.0.circle.center_m=[0.0, 0.0, 1.2]",
        "objective.track.0.circle.radius_m=0.2",
        "objective.track.0.circle.normal=[0.0, 1.0, 1.0]",
        "objective.track.0.circle.turn_s=2.0",
        "objective.track.0.circle.from_m=[0.0, 0.0, 1.5]",
        "objective.track.0.circle.ramp_s=0.5",
        "plant.section.diameter_m=0.09",
        "sensor.0.preset='imu'",
        "estimator.kind='none'",
    ],
    &[
        "rod.length_m=0.3",
        "rod.accuracy=0.002",
        "rod.material.preset='ecoflex-00-30'",
        "rod.section.diameter_base_m=0.02",
        "rod.section.diameter_tip_m=0.01",
        "time.end_s=1.0",
        "task.position_m=[0.05, 0.0, 0.25]",
        "task.at_rest='tip'",
        "task.tolerance_m_s=0.001",
        "task.tolerance_rad_s=0.01",
        "control.force_max_n=1.0",
        "control.distributed.points=2",
        "control.distributed.moment_max_n_m_per_m=0.1",
        "objective.track.0.from_s=0.4",
        "objective.track.0.orientations_wxyz=[[0.0, 1.0, 0.0, 0.0, 0.0], [1.0, 1.0, 0.1, 0.0, 0.0]]",
        "objective.track.0.orientation_weight=3.0",
        "objective.track.0.speed_weight=0.1",
        "objective.track.0.figure_eight.center_m=[0.0, 0.0, 0.28]",
        "objective.track.0.figure_eight.half_length_m=0.02",
        "objective.track.0.figure_eight.normal=[0.0, 1.0, 1.0]",
        "objective.track.0.figure_eight.turn_s=2.0",
        "objective.track.0.figure_eight.from_m=[0.0, 0.0, 0.3]",
        "objective.track.0.figure_eight.ramp_s=0.5",
        "plant.section.diameter_base_m=0.021",
        "plant.section.diameter_tip_m=0.011",
    ],
    &[
        "rod.length_m=0.5",
        "rod.elements=12",
        "rod.material.youngs_modulus_pa=1e6",
        "rod.material.poisson_ratio=0.45",
        "rod.material.density_kg_m3=1070.0",
        "rod.section.shape='ring'",
        "rod.section.radius_m=0.02",
        "rod.section.inner_radius_m=0.01",
        "time.end_s=1.0",
        "plant.section.shape='ring'",
        "plant.section.radius_m=0.02",
        "plant.section.inner_radius_m=0.011",
    ],
    &[
        "rod.length_m=0.5",
        "rod.elements=12",
        "rod.material.youngs_modulus_pa=1e6",
        "rod.material.poisson_ratio=0.45",
        "rod.material.density_kg_m3=1070.0",
        "rod.section.shape='ring'",
        "rod.section.diameter_m=0.04",
        "rod.section.inner_diameter_m=0.02",
        "time.end_s=1.0",
        "plant.section.shape='ring'",
        "plant.section.diameter_m=0.04",
        "plant.section.inner_diameter_m=0.022",
    ],
    &[
        "rod.length_m=0.5",
        "rod.elements=12",
        "rod.material.youngs_modulus_pa=1e6",
        "rod.material.poisson_ratio=0.45",
        "rod.material.density_kg_m3=1070.0",
        "rod.section.shape='rectangle'",
        "rod.section.width_m=0.03",
        "rod.section.height_m=0.01",
        "rod.section.roll_rad=0.2",
        "time.end_s=1.0",
        "plant.section.shape='rectangle'",
        "plant.section.width_m=0.03",
        "plant.section.height_m=0.011",
        "plant.section.roll_rad=0.2",
    ],
    &[
        "rod.length_m=0.5",
        "rod.elements=12",
        "rod.material.youngs_modulus_pa=1e6",
        "rod.material.poisson_ratio=0.45",
        "rod.material.density_kg_m3=1070.0",
        "rod.section.radius_m=0.02",
        "rod.segment.0.length_m=0.125",
        "rod.segment.0.material.youngs_modulus_pa=2e6",
        "rod.segment.0.material.poisson_ratio=0.4",
        "rod.segment.0.material.density_kg_m3=1100.0",
        "rod.segment.0.material.shear_factor=0.9",
        "rod.segment.0.section.shape='rectangle'",
        "rod.segment.0.section.width_m=0.03",
        "rod.segment.0.section.height_m=0.02",
        "rod.segment.0.section.roll_rad=0.1",
        "rod.segment.1.fraction=0.125",
        "rod.segment.1.material.preset='ecoflex-00-30'",
        "rod.segment.1.section.diameter_m=0.03",
        "rod.segment.1.reference.curvature_1_m=[0.0, 1.0, 0.0]",
        "rod.segment.2.fraction=0.125",
        "rod.segment.2.material.youngs_modulus_pa=2e6",
        "rod.segment.2.material.shear_modulus_pa=6e5",
        "rod.segment.2.material.density_kg_m3=1100.0",
        "rod.segment.2.section.shape='ring'",
        "rod.segment.2.section.radius_m=0.02",
        "rod.segment.2.section.inner_radius_m=0.01",
        "rod.segment.3.fraction=0.125",
        "rod.segment.3.section.shape='ring'",
        "rod.segment.3.section.diameter_m=0.04",
        "rod.segment.3.section.inner_diameter_m=0.02",
        "rod.segment.4.fraction=0.125",
        "rod.segment.4.section.radius_base_m=0.02",
        "rod.segment.4.section.radius_tip_m=0.015",
        "rod.segment.5.fraction=0.125",
        "rod.segment.5.section.shape='circle'",
        "rod.segment.5.section.radius_m=0.02",
        "rod.segment.6.fraction=0.0625",
        "rod.segment.6.section.diameter_base_m=0.02",
        "rod.segment.6.section.diameter_tip_m=0.015",
        "rod.segment.7.fraction=0.03125",
        "rod.segment.7.display_radius_m=0.02",
        "rod.segment.7.stiffness.ea_n=1000.0",
        "rod.segment.7.stiffness.ga_n=400.0",
        "rod.segment.7.stiffness.ei_n_m2=1.0",
        "rod.segment.7.stiffness.gj_n_m2=0.8",
        "rod.segment.7.stiffness.roll_rad=0.1",
        "rod.segment.7.inertia.mass_kg_m=1.0",
        "rod.segment.7.inertia.rotary_kg_m=[0.001, 0.001, 0.002]",
        "rod.segment.8.fraction=0.03125",
        "rod.segment.8.stiffness.ea_n=1000.0",
        "rod.segment.8.stiffness.ga_n=[400.0, 300.0]",
        "rod.segment.8.stiffness.ei_n_m2=[1.0, 2.0]",
        "rod.segment.8.stiffness.gj_n_m2=0.8",
        "rod.segment.8.stiffness.roll_rad=0.1",
        "rod.segment.8.inertia.mass_kg_m=1.0",
        "rod.segment.8.inertia.rotary_kg_m=[0.001, 0.002, 0.003]",
        "body.0.at=0.5",
        "body.0.mass_kg=0.1",
        "body.0.inertia_kg_m2=[0.001, 0.002, 0.003]",
        "time.end_s=1.0",
    ],
    &[
        "rod.length_m=0.5",
        "rod.elements=12",
        "rod.stiffness.ea_n=1000.0",
        "rod.stiffness.ga_n=[400.0, 300.0]",
        "rod.stiffness.ei_n_m2=[1.0, 3.0]",
        "rod.stiffness.gj_n_m2=0.8",
        "rod.stiffness.roll_rad=-0.3",
        "rod.inertia.mass_kg_m=2.0",
        "rod.inertia.rotary_kg_m=[0.001, 0.003, 0.004]",
        "rod.reference.curvature_along_1_m=[[0.0, 0.0, 0.1, 0.0], [1.0, 0.0, 0.2, 0.0]]",
        "time.end_s=1.0",
    ],
    &[
        "rod.length_m=0.3",
        "rod.elements=8",
        "rod.material.youngs_modulus_pa=1e5",
        "rod.material.poisson_ratio=0.4",
        "rod.material.density_kg_m3=1070.0",
        "rod.section.radius_m=0.01",
        "tendon.0.name='front'",
        "tendon.0.offset_m=[0.008, 0.0]",
        "tendon.0.offset_to_m=[0.004, 0.0]",
        "tendon.0.turns=0.25",
        "tendon.0.from=0.1",
        "tendon.0.to=0.9",
        "tendon.0.tension_n=[0.0, 2.0]",
        "tendon.0.rate_n_s=5.0",
        "tendon.0.pretension_n=0.1",
        "tendon.1.offset_m=[-0.008, 0.0]",
        "tendon.1.tension_n=[0.0, inf]",
        "tendon.1.rate_n_s=[-5.0, 2.5]",
        "tendon.2.offset_m=[0.0, 0.008]",
        "tendon.2.profile=[[0.0, 0.0], [0.5, 0.1]]",
        "tendon.1.lag_s=0.02",
        "tendon.3.offset_m=[0.0, -0.008]",
        "tendon.3.displacement_m=[-0.02, 0.005]",
        "tendon.3.rate_m_s=[-0.1, 0.2]",
        "tendon.3.rest_displacement_m=-0.001",
        "tendon.3.compliance_1_n=1e-3",
        "tendon.3.free_length_m=0.05",
        "tendon.3.disk_spacing_m=0.02",
        "tendon.3.hole_clearance_m=0.0002",
        "tendon.3.friction=0.1",
        "tendon.3.sliding_speed_m_s=2e-3",
        "tendon.3.sliding='released'",
        "tendon.4.friction=0.1",
        "tendon.4.sliding='none'",
        "tendon.2.friction=0.1",
        "tendon.2.sliding='pulled'",
        "tendon.4.offset_m=[0.0, -0.006]",
        "tendon.4.displacement_profile=[[0.0, 0.0], [0.5, -0.001]]",
        "tendon.4.compliance_1_n=1e-3",
        "tendon.5.offset_m=[-0.006, 0.0]",
        "tendon.5.tension_n=[0.0, 2.0]",
        "tendon.5.pretension_n=0.2",
        "tendon.5.follows.name='front'",
        "tendon.5.follows.gain=-0.5",
        "chamber.0.name='left'",
        "chamber.0.area_m2=5e-5",
        "chamber.0.offset_m=[0.005, 0.0]",
        "chamber.0.offset_to_m=[0.003, 0.0]",
        "chamber.0.turns=0.5",
        "chamber.0.from=0.2",
        "chamber.0.to=0.8",
        "chamber.0.pressure_pa=[0.0, 1e4]",
        "chamber.0.rate_pa_s=1e5",
        "chamber.0.rest_pressure_pa=100.0",
        "chamber.1.area_m2=5e-5",
        "chamber.1.offset_m=[-0.005, 0.0]",
        "chamber.1.pressure_pa=[0.0, 1e4]",
        "chamber.1.rate_pa_s=[-1e4, 1e5]",
        "chamber.1.lag_s=0.05",
        "chamber.2.area_m2=5e-5",
        "chamber.2.offset_m=[0.0, 0.005]",
        "chamber.2.profile=[[0.0, 0.0], [0.5, 1000.0]]",
        "chamber.3.area_m2=5e-5",
        "chamber.3.offset_m=[0.0, -0.005]",
        "chamber.3.pressure_pa=[0.0, inf]",
        "chamber.3.follows.name='left'",
        "chamber.3.follows.gain=0.5",
        "muscle.0.name='dorsal'",
        "muscle.0.area_m2=5e-5",
        "muscle.0.stress_pa=1e4",
        "muscle.0.offset_m=[0.0, 0.006]",
        "muscle.0.offset_to_m=[0.0, 0.003]",
        "muscle.0.turns=-0.5",
        "muscle.0.from=0.0",
        "muscle.0.to=0.7",
        "muscle.0.activation=[0.0, 1.0]",
        "muscle.0.rate_1_s=10.0",
        "muscle.0.rest_activation=0.05",
        "muscle.1.area_m2=5e-5",
        "muscle.1.stress_pa=1e4",
        "muscle.1.offset_m=[0.0, -0.006]",
        "muscle.1.activation=[0.0, 1.0]",
        "muscle.1.rate_1_s=[-5.0, 10.0]",
        "muscle.1.lag_s=0.04",
        "muscle.2.area_m2=5e-5",
        "muscle.2.stress_pa=1e4",
        "muscle.2.offset_m=[0.006, 0.0]",
        "muscle.2.profile=[[0.0, 0.0], [0.5, 0.2]]",
        "muscle.3.area_m2=5e-5",
        "muscle.3.stress_pa=1e4",
        "muscle.3.offset_m=[-0.006, 0.0]",
        "muscle.3.activation=[0.0, 1.0]",
        "muscle.3.rest_activation=0.5",
        "muscle.3.follows.name='dorsal'",
        "muscle.3.follows.gain=-1.0",
        "braid.0.name='mckibben'",
        "braid.0.fibre=1.4",
        "braid.0.turns_1_m=-12.0",
        "braid.0.offset_m=[0.0, 0.006]",
        "braid.0.offset_to_m=[0.0, 0.003]",
        "braid.0.turns=0.5",
        "braid.0.from=0.1",
        "braid.0.to=0.7",
        "braid.0.pressure_pa=[0.0, 1e4]",
        "braid.0.rate_pa_s=[-1e5, 2e5]",
        "braid.0.lag_s=0.02",
        "braid.0.rest_pressure_pa=200.0",
        "braid.1.fibre=1.4",
        "braid.1.turns_1_m=12.0",
        "braid.1.profile=[[0.0, 0.0], [0.5, 200.0]]",
        "braid.2.fibre=1.4",
        "braid.2.turns_1_m=12.0",
        "braid.2.offset_m=[0.0, 0.006]",
        "braid.2.pressure_pa=[0.0, 1e4]",
        "braid.2.rest_pressure_pa=200.0",
        "braid.2.follows.name='mckibben'",
        "braid.2.follows.gain=1.0",
        "learned.0.name='what the braid lacks'",
        "learned.0.of=['mckibben']",
        "learned.0.from=0.2",
        "learned.0.to=0.5",
        "learned.0.strains.0='toward'",
        "learned.0.grid=[[-5.0, 5.0, 3.0]]",
        "learned.0.weights=[1e-9, 0.0, 2e-9]",
        "learned.1.strains.0='bend_1'",
        "learned.1.centers=[[1.0], [2.0]]",
        "learned.1.radii=[4.0]",
        "learned.2.strains.0='twist'",
        "learned.2.slopes=[[0.5], [-0.3]]",
        "learned.2.offsets=[0.0, 0.1]",
        "time.end_s=0.5",
        "task.position_m=[0.02, 0.0, 0.29]",
    ],
    &[
        "rod.length_m=0.3",
        "rod.elements=8",
        "rod.material.youngs_modulus_pa=1e5",
        "rod.material.poisson_ratio=0.4",
        "rod.material.density_kg_m3=1070.0",
        "rod.section.radius_m=0.01",
        "magnet.0.name='tip'",
        "magnet.0.at=0.9",
        "magnet.0.moment_a_m2=[0.0, 0.01, 0.1]",
        "magnet.0.field_t=[[-0.02, 0.04], [-0.02, 0.02], [0.01, 0.01]]",
        "magnet.0.rate_t_s=0.5",
        "magnet.0.rest_field_t=[0.01, 0.0, 0.01]",
        "magnet.0.gradient_t_m=[[-1.0, 1.0], [-1.0, 1.0], [0.0, 0.0], [0.0, 0.0], [-0.5, 1.0]]",
        "magnet.0.gradient_rate_t_m_s=20.0",
        "magnet.0.rest_gradient_t_m=[0.1, 0.0, 0.0, 0.0, 0.2]",
        "magnet.0.center_m=[0.0, 0.0, 0.2]",
        "magnet.1.along=[0.2, 0.5]",
        "magnet.1.remanence_t=0.9",
        "magnet.1.volume_m3=1e-9",
        "magnet.1.axis=[1.0, 0.0, 1.0]",
        "magnet.1.field_of='tip'",
        "magnet.2.moment_a_m2=[0.0, 0.01, 0.0]",
        "magnet.2.profile=[[0.0, 0.0, 0.0, 0.0], [0.5, 0.01, 0.02, 0.0]]",
        "magnet.2.gradient_profile=[[0.0, 0.0, 0.0, 0.0, 0.0, 0.0], [0.5, 0.1, 0.2, 0.0, 0.3, 0.0]]",
        "magnet.3.moment_a_m2=[0.0, 0.0, 0.01]",
        "magnet.3.field_t=[[-inf, inf], [0.0, 0.0], [0.0, 0.0]]",
        "magnet.3.rate_t_s=[-0.5, 1.0]",
        "magnet.3.gradient_t_m=[[-1.0, 1.0], [0.0, 0.0], [0.0, 0.0], [0.0, 0.0], [0.0, 0.0]]",
        "magnet.3.gradient_rate_t_m_s=[-20.0, 10.0]",
        "cable.0.name='stay'",
        "cable.0.at=0.7",
        "cable.0.offset_m=[0.01, 0.0]",
        "cable.0.anchor_m=[0.2, 0.1, 0.3]",
        "cable.0.tension_n=[0.0, 0.2]",
        "cable.0.rate_n_s=2.0",
        "cable.0.pretension_n=0.01",
        "cable.1.anchor_m=[-0.2, 0.1, 0.3]",
        "cable.1.tension_n=[0.0, inf]",
        "cable.1.rate_n_s=[-2.0, 1.0]",
        "cable.2.anchor_m=[0.0, 0.3, 0.3]",
        "cable.2.profile=[[0.0, 0.0], [0.5, 0.1]]",
        "time.end_s=0.5",
        "task.position_m=[0.02, 0.0, 0.29]",
    ],
    &[
        "rod.length_m=1.5",
        "rod.elements=12",
        "rod.material.youngs_modulus_pa=1e6",
        "rod.material.poisson_ratio=0.45",
        "rod.material.density_kg_m3=1070.0",
        "rod.section.radius_m=0.04",
        "time.end_s=1.0",
        "base.kind='pinned'",
        "base.position_m=[0.0, 0.0, 0.0]",
        "base.axis=[0.0, 1.0, 0.0]",
        "initial.shape='equilibrium'",
        "tip.kind='driven'",
        "tip.position_m=[0.1, 0.0, 1.4]",
        "tip.direction=[0.0, 0.0, 1.0]",
        "tip.roll_rad=0.1",
        "tip.motion.velocity_m_s=[0.1, 0.0, 0.0]",
        "tip.motion.angular_velocity_rad_s=[0.0, 0.0, 0.5]",
        "tip.motion.translation_m=[[0.0, 0.0, 0.0, 0.0], [1.0, 0.1, 0.2, 0.0]]",
        "tip.motion.rotation_rad=[[0.0, 0.0, 0.0, 0.0], [1.0, 0.1, 0.2, 0.3]]",
        "tip.motion.rotation_frame='body'",
        "tip.motion.oscillation.0.translation_m=[0.0, 0.01, 0.0]",
        "tip.motion.oscillation.0.rotation_rad=[0.0, 0.01, 0.0]",
        "tip.motion.oscillation.0.frequency_hz=2.0",
        "tip.motion.oscillation.0.phase_rad=0.5",
    ],
    &[
        "rod.length_m=1.5",
        "rod.elements=12",
        "rod.material.youngs_modulus_pa=1e6",
        "rod.material.poisson_ratio=0.45",
        "rod.material.density_kg_m3=1070.0",
        "rod.section.radius_m=0.04",
        "time.end_s=1.0",
        "tip.kind='pinned'",
        "tip.axis=[0.0, 1.0, 0.0]",
        "tip.orientation_wxyz=[1.0, 0.0, 0.0, 0.0]",
        "task.node=0.5",
        "task.position_m=[0.1, 0.0, 0.7]",
        "task.direction=[0.2, 0.0, 1.0]",
        "task.velocity_m_s=[0.1, 0.0, 0.0]",
        "task.at_rest=false",
        "task.via.0.at_s=0.5",
        "task.via.0.node=0.25",
        "task.via.0.direction=[0.1, 0.0, 1.0]",
        "objective.track.0.node=0.5",
        "objective.track.0.directions=[[0.0, 0.0, 0.0, 1.0], [1.0, 0.2, 0.0, 1.0]]",
        "control.actuator.0.node=6",
        "control.actuator.0.force_max_n=5.0",
    ],
    &[
        "rod.length_m=1.5",
        "rod.elements=12",
        "rod.material.youngs_modulus_pa=1e6",
        "rod.material.poisson_ratio=0.45",
        "rod.material.density_kg_m3=1070.0",
        "rod.section.radius_m=0.04",
        "time.end_s=1.0",
        "initial.shape=[[0.0, 0.1, 0.0, 0.0], [1.0, 0.0, 0.2, 0.0]]",
    ],
    &[
        "rod.length_m=1.5",
        "rod.elements=12",
        "rod.material.youngs_modulus_pa=1e6",
        "rod.material.poisson_ratio=0.45",
        "rod.material.density_kg_m3=1070.0",
        "rod.section.radius_m=0.04",
        "time.end_s=1.0",
        "base.kind='free'",
        "task.node=0",
        "task.position_m=[0.1, 0.0, 0.1]",
        "task.at_rest=false",
        "control.force_max_n=5.0",
    ],
    &[
        "rod.length_m=1.5",
        "rod.elements=12",
        "rod.material.youngs_modulus_pa=1e6",
        "rod.material.poisson_ratio=0.45",
        "rod.material.density_kg_m3=1070.0",
        "rod.section.radius_m=0.04",
        "time.end_s=1.0",
        "initial.state.length_m=1.5",
        "initial.state.at=[0.0, 1.0]",
        "initial.state.position_m=[[0.0, 0.0, 0.0], [0.0, 0.0, 1.5]]",
        "initial.state.rotation=[[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0], [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]]",
        "initial.state.momentum_kg_m_s=[[0.0, 0.0, 0.0], [0.1, 0.0, 0.0]]",
        "initial.state.angular_momentum_kg_m2_s=[[0.0, 0.0, 0.0], [0.0, 0.001, 0.0]]",
        "initial.state.mass_kg=[1.0, 1.0]",
        "initial.state.inertia_kg_m2=[[0.01, 0.01, 0.001], [0.01, 0.01, 0.001]]",
    ],
    &[
        "rod.length_m=1.5",
        "rod.elements=12",
        "rod.material.youngs_modulus_pa=1e6",
        "rod.material.poisson_ratio=0.45",
        "rod.material.density_kg_m3=1070.0",
        "rod.section.radius_m=0.04",
        "time.end_s=1.0",
        "tendon.0.name='front'",
        "tendon.0.offset_m=[0.03, 0.0]",
        "tendon.0.tension_n=[0.0, 2.0]",
        "tendon.0.friction=0.1",
        "tendon.1.offset_m=[0.0, 0.03]",
        "tendon.1.displacement_m=[-0.02, 0.005]",
        "tendon.1.rate_m_s=0.1",
        "tendon.1.compliance_1_n=1e-3",
        "chamber.0.name='left'",
        "chamber.0.area_m2=5e-5",
        "chamber.0.offset_m=[0.005, 0.0]",
        "chamber.0.pressure_pa=[0.0, 1e4]",
        "muscle.0.name='dorsal'",
        "muscle.0.area_m2=5e-5",
        "muscle.0.stress_pa=1e4",
        "muscle.0.offset_m=[0.0, 0.006]",
        "muscle.0.activation=[0.0, 1.0]",
        "plant.tendon.0.name='front'",
        "plant.tendon.0.offset_m=[0.02, 0.0]",
        "plant.tendon.0.offset_to_m=[0.01, 0.0]",
        "plant.tendon.0.effort_factor=0.9",
        "plant.tendon.0.play=0.01",
        "plant.tendon.0.lag_s=0.02",
        "plant.tendon.0.saturation=[0.0, 1.5]",
        "plant.tendon.0.friction=0.2",
        "plant.chamber.0.name='left'",
        "plant.chamber.0.offset_m=[0.02, 0.0]",
        "plant.chamber.0.offset_to_m=[0.01, 0.0]",
        "plant.chamber.0.effort_factor=0.9",
        "plant.chamber.0.play=0.01",
        "plant.chamber.0.lag_s=0.02",
        "plant.chamber.0.saturation=[0.0, 1.5]",
        "plant.muscle.0.name='dorsal'",
        "plant.muscle.0.offset_m=[0.02, 0.0]",
        "plant.muscle.0.offset_to_m=[0.01, 0.0]",
        "plant.muscle.0.effort_factor=0.9",
        "plant.muscle.0.play=0.01",
        "plant.muscle.0.lag_s=0.02",
        "plant.muscle.0.saturation=[0.0, 1.5]",
        "braid.0.name='mckibben'",
        "braid.0.fibre=1.4",
        "braid.0.turns_1_m=12.0",
        "braid.0.pressure_pa=[0.0, 1e4]",
        "braid.0.rate_pa_s=1e5",
        "plant.braid.0.name='mckibben'",
        "plant.braid.0.offset_m=[0.02, 0.0]",
        "plant.braid.0.offset_to_m=[0.01, 0.0]",
        "plant.braid.0.effort_factor=0.9",
        "plant.braid.0.play=0.01",
        "plant.braid.0.lag_s=0.02",
        "plant.braid.0.saturation=[0.0, 1.5]",
        "sensor.0.preset='mocap'",
        "estimator.kind='kalman'",
        "estimator.disturbances.0='friction'",
        "task.position_m=[0.1, 0.0, 1.45]",
    ],
];

/// `KEY=VALUE` as its two parts.
fn entry(text: &str) -> (&str, Value) {
    let (key, value) = text.split_once('=').unwrap();
    (key, value.parse().unwrap())
}

fn at<'a>(root: &'a Value, key: &str) -> Option<&'a Value> {
    key.split('.').try_fold(root, |value, part| match value {
        Value::Array(items) => items.get(part.parse::<usize>().ok()?),
        other => other.get(part),
    })
}

fn insert(root: &mut Value, path: &[&str], value: Value) {
    let Some((first, rest)) = path.split_first() else {
        *root = value;
        return;
    };
    let is_index = |part: &str| part.parse::<usize>().is_ok();
    let empty = if rest.first().is_some_and(|next| is_index(next)) {
        Value::Array(Vec::new())
    } else {
        Value::Table(toml::Table::new())
    };
    let inner = match root {
        Value::Array(items) => {
            let index: usize = first.parse().unwrap();
            if index == items.len() {
                items.push(empty);
            }
            &mut items[index]
        }
        Value::Table(table) => table.entry(*first).or_insert(empty),
        other => panic!("{other} has no entries"),
    };
    insert(inner, rest, value);
}

/// The scene of these entries, written as a text.
fn from_text(entries: &[&str]) -> Result<Scene, String> {
    let mut root = Value::Table(toml::Table::new());
    for text in entries {
        let (key, value) = entry(text);
        insert(&mut root, &key.split('.').collect::<Vec<_>>(), value);
    }
    let text = toml::to_string(&root).unwrap();
    match Scene::from_toml("keys", &text, &[]) {
        Ok((scene, _)) => Ok(scene),
        Err(error) => Err(format!("{error}\n{text}")),
    }
}

/// The scene of these entries, each given by an override of its own.
fn from_overrides(entries: &[&str]) -> Result<Scene, String> {
    let overrides: Vec<String> = entries.iter().map(|text| text.to_string()).collect();
    match Scene::from_toml("keys", "[rod]\n[time]\n", &overrides) {
        Ok((scene, _)) => Ok(scene),
        Err(error) => Err(error.to_string()),
    }
}

/// Whether every entry stands in the scene as it is written out.
fn arrives(scene: &Scene, entries: &[&str]) -> Result<(), String> {
    let written = scene.to_toml();
    let root: Value = toml::from_str(&written).unwrap();
    for text in entries {
        let (key, value) = entry(text);
        match at(&root, key) {
            Some(found) if *found == value => {}
            found => return Err(format!("{key} is {found:?}, was given {value:?}")),
        }
    }
    Ok(())
}

/// Name of the form of a value: a choice by its word, everything else by its type in a schema.
fn form_of(value: &Value, words: &BTreeSet<String>) -> String {
    match value {
        Value::String(word) if words.contains(word) => format!("'{word}'"),
        Value::String(_) => "string".into(),
        Value::Integer(_) => "integer".into(),
        Value::Float(_) => "number".into(),
        Value::Boolean(_) => "boolean".into(),
        Value::Array(_) => "array".into(),
        Value::Table(_) => "object".into(),
        Value::Datetime(_) => "date".into(),
    }
}

/// The dotted path of every key of the schema that holds a value, with the forms of the value; of a list of sections, the first one.
fn leaves(schema: &Json) -> BTreeMap<String, BTreeSet<String>> {
    fn walk(root: &Json, node: &Json, path: &str, out: &mut BTreeMap<String, BTreeSet<String>>) {
        let inner = |key: &str| match path {
            "" => key.to_string(),
            path => format!("{path}.{key}"),
        };
        if let Some(name) = node["$ref"].as_str() {
            let name = name.rsplit('/').next().unwrap();
            return walk(root, &root["$defs"][name], path, out);
        }
        let mut alternatives = ["anyOf", "oneOf", "allOf"]
            .into_iter()
            .filter_map(|key| node[key].as_array())
            .flatten()
            .peekable();
        if alternatives.peek().is_some() {
            alternatives.for_each(|one| walk(root, one, path, out));
            return;
        }
        if let Some(properties) = node["properties"].as_object() {
            for (key, property) in properties {
                walk(root, property, &inner(key), out);
            }
            return;
        }
        let sections = &node["items"];
        if sections["$ref"].is_string() || sections["properties"].is_object() {
            return walk(root, sections, &inner("0"), out);
        }
        let types: Vec<&str> = match &node["type"] {
            Json::String(one) => vec![one],
            Json::Array(several) => several.iter().filter_map(Json::as_str).collect(),
            other => panic!("{path}: a schema without a type: {other}"),
        };
        let words: Vec<&Json> = (node["enum"].as_array().into_iter().flatten())
            .chain(node.get("const"))
            .collect();
        let forms = out.entry(path.to_string()).or_default();
        if words.is_empty() {
            forms.extend(types.iter().map(|name| name.to_string()));
        }
        forms.extend(
            words
                .iter()
                .map(|word| format!("'{}'", word.as_str().unwrap())),
        );
        // That a section may be absent is none of its forms.
        forms.remove("null");
        if forms.is_empty() {
            out.remove(path);
        }
    }
    let mut out = BTreeMap::new();
    walk(schema, schema, "", &mut out);
    out
}

/// Every key of the schema, in each of its forms, is read from a text and from an override, and the scene that is written out has it:
/// the scenes above, and for the words of a choice the first of these scenes that accepts them.
#[test]
fn every_key_can_be_set() {
    let mut leaves = leaves(&Scene::schema());
    // A file, whose rows take its place: tests/scenes/scene_paths.rs.
    leaves.remove("objective.track.0.path_csv");
    // A file, whose numbers take its place: tests/verbs/learned.rs.
    leaves.remove("learned.0.file");
    // Directories, whose margins take their place: tests/verbs/doubt.rs.
    leaves.remove("doubt.runs");
    // A directory, whose state takes its place: tests/verbs/continued.rs.
    leaves.remove("initial.from");
    let mut given: BTreeMap<String, BTreeSet<String>> = BTreeMap::new();
    for entries in SCENES {
        for text in entries {
            let (key, value) = entry(text);
            // Sections of a list are alike: the schema knows the first.
            let parts = key.split('.').map(|part| match part.parse::<usize>() {
                Ok(_) => "0",
                Err(_) => part,
            });
            let key = parts.collect::<Vec<_>>().join(".");
            let words = leaves.get(&key).into_iter().flatten();
            let words = words.map(|form| form.trim_matches('\'').to_string());
            let form = form_of(&value, &words.collect());
            given.entry(key).or_default().insert(form);
        }
        let text = from_text(entries).unwrap_or_else(|error| panic!("{error}"));
        let set = from_overrides(entries).unwrap_or_else(|error| panic!("{error}"));
        assert_eq!(text, set);
        arrives(&text, entries).unwrap_or_else(|error| panic!("{error}"));
    }
    let mut missing = Vec::new();
    for (key, forms) in &leaves {
        let empty = BTreeSet::new();
        for form in forms.difference(given.get(key).unwrap_or(&empty)) {
            let choice = format!("{key}={form}");
            let is_read = |entries: &&[&str]| {
                let mut entries: Vec<&str> = entries.to_vec();
                entries.retain(|text| entry(text).0 != key);
                entries.push(&choice);
                [from_text(&entries), from_overrides(&entries)]
                    .into_iter()
                    .all(|scene| scene.is_ok_and(|scene| arrives(&scene, &[&choice]).is_ok()))
            };
            if !(form.starts_with('\'') && SCENES.iter().any(is_read)) {
                missing.push(choice);
            }
        }
    }
    assert!(missing.is_empty(), "no example is read of {missing:#?}");
    let unknown: Vec<_> = given
        .keys()
        .filter(|key| !leaves.contains_key(*key))
        .collect();
    assert!(unknown.is_empty(), "not in the schema: {unknown:?}");
}

/// Both forms of a continuation arrive in the solver's settings, as a section and as an inline table, in a text and by an override.
#[test]
fn continuation_arrives() {
    let search = |overrides: &[&str]| {
        let overrides: Vec<String> = overrides.iter().map(|text| text.to_string()).collect();
        let (scene, source) = Scene::load("reach", &overrides).unwrap();
        scene.optimal_control(&source).unwrap().search.continuation
    };
    let target = Some(Continuation::Target(3));
    assert_eq!(search(&["solver.continuation={target = 3}"]), target);
    assert_eq!(search(&["solver.continuation.target=3"]), target);
    assert_eq!(
        search(&["solver={continuation = {load = 2}}"]),
        Some(Continuation::Load(2))
    );
    assert_eq!(search(&[]), None);
}

/// A choice that carries a value says so when it is given as a word, when it is no choice, and when there are two of them.
#[test]
fn choices_with_values_explain_themselves() {
    let error = |value: &str| {
        let text = format!("solver.continuation={value}");
        let overrides = [text];
        let error = Scene::load("reach", &overrides).unwrap_err();
        (error.key().unwrap().to_string(), format!("{error}"))
    };
    let cases = [
        (
            "'target'",
            "solver.continuation",
            "expected { target = ... }",
        ),
        ("3", "solver.continuation", "one of \"target\", \"load\""),
        ("{}", "solver.continuation", "one of \"target\", \"load\""),
        (
            "{target = 3, load = 2}",
            "solver.continuation",
            "a section of 2",
        ),
        (
            "{tagret = 3}",
            "solver.continuation.tagret",
            "did you mean \"target\"?",
        ),
        (
            "{target = 'x'}",
            "solver.continuation.target",
            "a whole number",
        ),
        ("{target = 0}", "solver.continuation.target", "from 1 to"),
    ];
    for (value, key, part) in cases {
        let (found, text) = error(value);
        assert_eq!(found, key, "{text}");
        assert!(text.contains(part), "{value}: {text}");
    }
    // A choice without a value is still a word, not a section.
    let overrides = ["solver.guess={rest = 1}".to_string()];
    let text = Scene::load("reach", &overrides).unwrap_err().to_string();
    assert!(text.contains("\"rest\" has no value"), "{text}");
}

/// A node that is named by a fraction of the length is the nearest one, of loads, tracks, limits and points on the way; 1 is a node and 1.0 the tip.
#[test]
fn nodes_may_be_fractions() {
    use softarm::scene::Scene;
    let scene = |node: &str| {
        let text = format!(
            "[rod]\nlength_m = 1.0\nelements = 8\n[rod.material]\nyoungs_modulus_pa = 1e6\npoisson_ratio = 0.5\ndensity_kg_m3 = 1000.0\n\
             [rod.section]\nradius_m = 0.05\n[time]\nend_s = 0.5\n[[load]]\nnode = {node}\nforce_n = [1.0, 0.0, 0.0]\n[control]\nforce_max_n = 5.0\n\
             [task]\nposition_m = [0.1, 0.0, 0.95]\nat_rest = false\n[[task.via]]\nat_s = 0.25\nnode = {node}\nposition_m = [0.01, 0.0, 0.1]\n\
             [[limit]]\nspeed_max_m_s = 50.0\nnode = {node}\n"
        );
        Scene::from_toml("scene.toml", &text, &[])
    };
    let nodes = |node: &str| {
        let (scene, source) = scene(node).unwrap();
        let (again, _) = Scene::from_toml("again", &scene.to_toml(), &[]).unwrap();
        assert_eq!(scene, again);
        let problem = scene.optimal_control(&source).unwrap().problem;
        (
            problem.rod.loads[0].node,
            problem.goals[0].node,
            problem.path[0].limit.clone(),
        )
    };
    assert_eq!(nodes("0.25"), nodes("2"));
    assert_eq!(nodes("0.3"), nodes("2"));
    assert_eq!(nodes("0.5"), nodes("4"));
    assert_eq!(nodes("1").0, 1);
    let tip = scene("1.0").unwrap().0;
    assert_eq!(tip.load[0].node.index(&tip.mesh()), 8);
    for wrong in ["1.5", "-0.5", "\"middle\"", "9"] {
        let error = scene(wrong).unwrap_err();
        assert!(
            error.key().is_some_and(|key| key.ends_with(".node")),
            "{error}"
        );
    }
}
