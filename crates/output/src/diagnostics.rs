use std::path::Path;

use nalgebra::Vector3;

use super::{ArrayView, OutputError, npz};
use mechanics::{Diagnostics, PowerBalance, Rod};

/// Diagnostics at `n` times: the content of `diagnostics.npz`, whose rows correspond to those of `trajectory.npz`.
///
/// All arrays are flat in C order, with `K` elements. Energies and dilatation are in `trajectory.npz`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct DiagnosticsRecord {
    /// Number of elements of the arm.
    pub n_elements: usize,
    /// Tells whether the tip is held, so that it has a reaction.
    pub holds_tip: bool,
    /// `[n]` times, s.
    pub t: Vec<f64>,
    /// `[n, 3]` total linear momentum, spatial, kg m/s.
    pub linear_momentum: Vec<f64>,
    /// `[n, 3]` total angular momentum about the origin, spatial, kg m²/s.
    pub angular_momentum: Vec<f64>,
    /// `[n, K, 3]` shear, shear and stretch beyond the stress-free ones, body frame.
    pub linear_strain: Vec<f64>,
    /// `[n, K, 3]` curvatures and twist beyond the stress-free ones, body frame, 1/m.
    pub angular_strain: Vec<f64>,
    /// `[n, K, 3]` internal force, elastic and of internal damping, body frame, N.
    pub internal_force: Vec<f64>,
    /// `[n, K, 3]` internal moment, elastic and of internal damping, body frame, N m.
    pub internal_moment: Vec<f64>,
    /// `[n, 3]` reaction force at a held base, spatial, N; zero for a free one.
    pub base_force: Vec<f64>,
    /// `[n, 3]` reaction moment at a held base, body frame of the base, N m.
    pub base_moment: Vec<f64>,
    /// `[n, 3]` reaction force at a held tip, spatial, N; empty for a free one.
    pub tip_force: Vec<f64>,
    /// `[n, 3]` reaction moment at a held tip, body frame of the tip, N m; empty for a free one.
    pub tip_moment: Vec<f64>,
    /// `[n, 3]` gravity, loads and reactions together, spatial, N.
    pub external_force: Vec<f64>,
    /// `[n, 3]` moment of the external forces about the origin, spatial frame, N m.
    pub external_moment: Vec<f64>,
    /// `[n, 3]` mean force of viscous damping over the step that begins at the row, spatial, N.
    pub damping_force: Vec<f64>,
    /// `[n, 3]` moment of this damping about the origin, spatial frame, N m.
    pub damping_moment: Vec<f64>,
    /// `[n]` largest relative change of volume of any element.
    pub volume_error: Vec<f64>,
    /// `[n, 4]` power of the loads and of the base's drive, dissipated power, rate of change of the energy, and residual of the balance, W,
    /// over the step that ends at the row; zero in the first row.
    pub power: Vec<f64>,
}

/// The reaction of the base at some rows of `diagnostics.npz`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct BaseReaction {
    /// `[n]` times, s.
    pub t: Vec<f64>,
    /// `[n, 3]` force, spatial, N.
    pub force: Vec<f64>,
    /// `[n, 3]` moment, frame of the base, N m.
    pub moment: Vec<f64>,
}

impl BaseReaction {
    /// Cap on the rows of a curve.
    const MOST_ROWS: usize = 600;

    /// Reads at most 600 rows, evenly spread, of a file of `n_rows` rows.
    ///
    /// # Errors
    /// Returns [`OutputError`] for a missing array, and for one of another shape.
    pub fn read(path: &Path, n_rows: usize) -> Result<Self, OutputError> {
        let mut archive = npz::open(path)?;
        let malformed = |name: &str| {
            let name = name.to_string();
            move |reason| OutputError::malformed(path, format!("array {name}: {reason}"))
        };
        let (shape, t) =
            npz::read_array(&mut archive, "t", &[Some(n_rows)]).map_err(malformed("t"))?;
        let stride = shape[0].div_ceil(Self::MOST_ROWS).max(1);
        let mut read = |name: &str| {
            let (mut index, mut values) = (0, Vec::new());
            npz::visit_array(&mut archive, name, &[Some(t.len()), Some(3)], |value| {
                if (index / 3) % stride == 0 {
                    values.push(value);
                }
                index += 1;
                Ok(())
            })
            .map_err(malformed(name))?;
            Ok(values)
        };
        Ok(Self {
            force: read("base_force")?,
            moment: read("base_moment")?,
            t: t.into_iter().step_by(stride).collect(),
        })
    }
}

impl DiagnosticsRecord {
    /// Creates a record without rows.
    pub fn empty(rod: &Rod) -> Self {
        Self {
            n_elements: rod.n_elements(),
            holds_tip: !rod.has_free_tip(),
            ..Self::default()
        }
    }

    /// Creates a record of one row.
    pub fn row(t: f64, diagnostics: &Diagnostics, power: &PowerBalance) -> Self {
        let d = diagnostics;
        let vector = |v: &Vector3<f64>| v.as_slice().to_vec();
        let mut row = Self {
            n_elements: d.elements.len(),
            holds_tip: d.tip_reaction.is_some(),
            t: vec![t],
            linear_momentum: vector(&d.linear_momentum),
            angular_momentum: vector(&d.angular_momentum),
            base_force: vector(&d.reaction.force),
            base_moment: vector(&d.reaction.moment),
            tip_force: (d.tip_reaction).map_or_else(Vec::new, |tip| vector(&tip.force)),
            tip_moment: (d.tip_reaction).map_or_else(Vec::new, |tip| vector(&tip.moment)),
            external_force: vector(&d.external.force),
            external_moment: vector(&d.external.moment),
            damping_force: vector(&d.damping.force),
            damping_moment: vector(&d.damping.moment),
            volume_error: vec![d.volume_error],
            power: vec![
                power.external,
                power.dissipated,
                power.energy_rate,
                power.residual,
            ],
            ..Self::default()
        };
        for element in &d.elements {
            row.linear_strain.extend(element.linear_strain.iter());
            row.angular_strain.extend(element.angular_strain.iter());
            row.internal_force.extend(element.force.iter());
            row.internal_moment.extend(element.moment.iter());
        }
        row
    }

    /// Appends the rows of another record of the same arm.
    pub fn append(&mut self, other: &Self) {
        let own = [
            &mut self.t,
            &mut self.linear_momentum,
            &mut self.angular_momentum,
            &mut self.linear_strain,
            &mut self.angular_strain,
            &mut self.internal_force,
            &mut self.internal_moment,
            &mut self.base_force,
            &mut self.base_moment,
            &mut self.external_force,
            &mut self.external_moment,
            &mut self.damping_force,
            &mut self.damping_moment,
            &mut self.volume_error,
            &mut self.power,
            &mut self.tip_force,
            &mut self.tip_moment,
        ];
        for (values, (_, _, more)) in own.into_iter().zip(other.arrays()) {
            values.extend_from_slice(more);
        }
    }

    /// Writes the archive.
    ///
    /// # Errors
    /// Returns [`OutputError`] with the path.
    pub fn write_npz(&self, path: &Path) -> Result<(), OutputError> {
        npz::write(path, |archive| {
            for (name, shape, values) in self.arrays() {
                npz::write_array(archive, name, &shape, values.iter().map(|&value| Ok(value)))?;
            }
            Ok(())
        })
    }

    /// Returns name, shape and values of every array of the file, in the order of the file; those of the tip are there if it is held.
    pub fn arrays(&self) -> Vec<ArrayView<'_>> {
        let n = self.t.len();
        let vectors = || vec![n, 3];
        let elements = || vec![n, self.n_elements, 3];
        let mut out: Vec<ArrayView<'_>> = vec![
            ("t", vec![n], &self.t),
            ("linear_momentum", vectors(), &self.linear_momentum),
            ("angular_momentum", vectors(), &self.angular_momentum),
            ("linear_strain", elements(), &self.linear_strain),
            ("angular_strain", elements(), &self.angular_strain),
            ("internal_force", elements(), &self.internal_force),
            ("internal_moment", elements(), &self.internal_moment),
            ("base_force", vectors(), &self.base_force),
            ("base_moment", vectors(), &self.base_moment),
            ("external_force", vectors(), &self.external_force),
            ("external_moment", vectors(), &self.external_moment),
            ("damping_force", vectors(), &self.damping_force),
            ("damping_moment", vectors(), &self.damping_moment),
            ("volume_error", vec![n], &self.volume_error),
            ("power", vec![n, 4], &self.power),
        ];
        if self.holds_tip {
            out.push(("tip_force", vectors(), &self.tip_force));
            out.push(("tip_moment", vectors(), &self.tip_moment));
        }
        out
    }
}
