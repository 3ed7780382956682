//! Distances of a simulated arm from the obstacles of its scene, which the simulation itself does not use, and depths in what it touches.

use nalgebra::Vector3;

use crate::control::{PathLimit, Shape};
use crate::mechanics::Rod;
use crate::output::MotionRecord;
use crate::output::summary::{ClearanceSummary, DepthSummary};
use crate::scene::Simulation;

/// The obstacles with the smallest distances so far, and the contacts with the largest depths.
pub(super) struct Clearances {
    contacts: Vec<DepthSummary>,
    obstacles: Vec<Obstacle>,
    radii: Vec<f64>,
}

struct Obstacle {
    name: String,
    /// Shape and place at t = 0.
    shape: Shape,
    /// Velocity, m/s.
    velocity: Vector3<f64>,
    /// Number of points of an element at which the distance is computed.
    points: usize,
    least: ClearanceSummary,
}

impl Clearances {
    pub(super) fn of(setup: &Simulation) -> Self {
        let rod = &setup.rod;
        let radii = setup.arm.radii_at_nodes(&rod.mesh);
        let obstacles = (setup.resolved.limits().into_iter())
            .filter_map(|limit| {
                let PathLimit::Clearance {
                    shape, velocity, ..
                } = &limit.kind
                else {
                    return None;
                };
                let points = limit.kind.on(rod, &radii).points();
                Some(Obstacle {
                    shape: *shape,
                    velocity: *velocity,
                    points,
                    least: ClearanceSummary {
                        obstacle: limit.name.clone(),
                        least_m: f64::INFINITY,
                        at_s: 0.0,
                        place: 0.0,
                    },
                    name: limit.name,
                })
            })
            .collect();
        let contacts = (rod.contacts.iter())
            .map(|contact| DepthSummary {
                contact: contact.name.clone(),
                penetration_m: f64::NEG_INFINITY,
                over_penetration: f64::NEG_INFINITY,
                through: 0.0,
                allows_step_s: rod.contact_step(),
                at_s: 0.0,
                place: 0.0,
            })
            .collect();
        Self {
            contacts,
            obstacles,
            radii,
        }
    }

    /// Updates distances and depths with the one row of a record of a rod.
    pub(super) fn include(&mut self, row: &MotionRecord, rod: &Rod) {
        let t = row.t.last().copied().unwrap_or(0.0);
        if !self.contacts.is_empty() {
            let positions: Vec<_> = (row.x.chunks_exact(3))
                .map(Vector3::from_column_slice)
                .collect();
            let allowed = rod.contact_step_at(&positions, &mut Vec::new());
            self.include_depths(rod, t, &positions, allowed);
        }
        let n = row.n_nodes;
        let node = |q: usize| {
            let radius = self.radii.get(q).copied().unwrap_or(0.0);
            (Vector3::from_column_slice(&row.x[3 * q..3 * q + 3]), radius)
        };
        for obstacle in &mut self.obstacles {
            for item in 0..=(n - 1) * obstacle.points {
                let (q, s) = (item / obstacle.points, (item % obstacle.points) as f64);
                let s = s / obstacle.points as f64;
                let (a, b) = (node(q), node((q + 1).min(n - 1)));
                let x = a.0 + (b.0 - a.0) * s;
                let radius = a.1 + (b.1 - a.1) * s;
                let seen = x - obstacle.velocity * t;
                let distance = obstacle.shape.distance(&seen).value - radius;
                if distance < obstacle.least.least_m {
                    obstacle.least = ClearanceSummary {
                        obstacle: obstacle.name.clone(),
                        least_m: distance,
                        at_s: t,
                        place: (q as f64 + s) / (n - 1) as f64,
                    };
                }
            }
        }
    }

    /// Updates depths with positions at time `t`, at which all contacts together allow steps of `allowed`, s.
    pub(super) fn include_depths(
        &mut self,
        rod: &Rod,
        t: f64,
        positions: &[Vector3<f64>],
        allowed: f64,
    ) {
        for (deepest, own) in self.contacts.iter_mut().zip(rod.depths(positions)) {
            if own.depth > deepest.penetration_m {
                let contact = &rod.contacts[own.contact];
                deepest.penetration_m = own.depth;
                deepest.over_penetration = own.depth / contact.penetration;
                deepest.through = (own.depth / contact.holds_up_to(own.radius)).max(0.0);
                deepest.at_s = t;
                deepest.place = own.place;
            }
            if own.depth > 0.0 {
                deepest.allows_step_s = deepest.allows_step_s.min(allowed);
            }
        }
    }

    pub(super) fn depths(&self) -> Vec<DepthSummary> {
        self.contacts.clone()
    }

    pub(super) fn summary(&self) -> Vec<ClearanceSummary> {
        (self.obstacles.iter())
            .map(|obstacle| obstacle.least.clone())
            .collect()
    }
}
