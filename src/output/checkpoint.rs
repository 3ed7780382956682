use std::fs;
use std::io;
use std::path::Path;

use nalgebra::{Matrix3, Vector3};
use serde::{Deserialize, Serialize};

use super::OutputError;
use crate::mechanics::{Configuration, State};

/// Name of the checkpoint in a result directory, and in the directory of a run.
pub(super) const CHECKPOINT_FILE: &str = "checkpoint.json";
/// Name of a checkpoint that is being written.
pub(super) const FRESH_CHECKPOINT_FILE: &str = "checkpoint.json.new";
/// Version of the layout of a checkpoint.
const CHECKPOINT_VERSION: u32 = 1;

/// All that a simulation needs to go on as if it had never stopped. Its numbers are exact: they are written with as many
/// digits as it takes to read back the same bits.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Checkpoint {
    schema_version: u32,
    /// Version of the program; another one may compute other digits.
    softarm: String,
    /// Steps taken.
    pub step: usize,
    /// Time step, s.
    pub step_s: f64,
    /// The resolved scene, as TOML.
    pub scene: String,
    x: Vec<[f64; 3]>,
    /// Rows of the rotation matrices.
    #[serde(rename = "R")]
    rotation: Vec<[[f64; 3]; 3]>,
    linear_momentum: Vec<[f64; 3]>,
    angular_momentum: Vec<[f64; 3]>,
}

impl Checkpoint {
    /// After `step` steps of `step_s` seconds in `scene`.
    pub fn new(step: usize, step_s: f64, state: &State, scene: &str) -> Self {
        let arrays = |vectors: &[Vector3<f64>]| vectors.iter().map(|&v| v.into()).collect();
        Self {
            schema_version: CHECKPOINT_VERSION,
            softarm: env!("CARGO_PKG_VERSION").into(),
            step,
            step_s,
            scene: scene.into(),
            x: arrays(&state.configuration.positions),
            rotation: state
                .configuration
                .rotations
                .iter()
                .map(|r| r.transpose().into())
                .collect(),
            linear_momentum: arrays(&state.linear_momentum),
            angular_momentum: arrays(&state.angular_momentum),
        }
    }

    /// The state, to the bit.
    pub fn state(&self) -> State {
        let vectors = |arrays: &[[f64; 3]]| arrays.iter().map(|&v| v.into()).collect();
        State {
            configuration: Configuration {
                positions: vectors(&self.x),
                rotations: self
                    .rotation
                    .iter()
                    .map(|&rows| Matrix3::from(rows).transpose())
                    .collect(),
            },
            linear_momentum: vectors(&self.linear_momentum),
            angular_momentum: vectors(&self.angular_momentum),
        }
    }

    /// Whether `folder` holds a checkpoint.
    #[must_use]
    pub fn is_in(folder: &Path) -> bool {
        folder.join(CHECKPOINT_FILE).exists()
    }

    /// Reads the checkpoint in `folder`; `None` if there is none.
    pub fn read(folder: &Path) -> Result<Option<Self>, OutputError> {
        let path = folder.join(CHECKPOINT_FILE);
        let text = match fs::read_to_string(&path) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(None),
            other => other.map_err(OutputError::io(&path, "cannot read"))?,
        };
        let malformed = |reason: String| OutputError::malformed(&path, reason);
        let checkpoint: Self = serde_json::from_str(&text)
            .map_err(|error| malformed(format!("not a checkpoint: {error}")))?;
        let n = checkpoint.x.len();
        let this = env!("CARGO_PKG_VERSION");
        if checkpoint.schema_version != CHECKPOINT_VERSION || checkpoint.softarm != this {
            return Err(malformed(format!(
                "made by softarm {}, but this is {this}, which may compute other digits; start over without --resume",
                checkpoint.softarm
            )));
        }
        if [
            checkpoint.rotation.len(),
            checkpoint.linear_momentum.len(),
            checkpoint.angular_momentum.len(),
        ] != [n; 3]
        {
            return Err(malformed("its arrays are not of one length".into()));
        }
        Ok(Some(checkpoint))
    }

    /// Replaces the checkpoint in `folder` in one go: whoever reads it finds the old one or this one, whole.
    pub fn write(&self, folder: &Path) -> Result<(), OutputError> {
        let path = folder.join(CHECKPOINT_FILE);
        let fresh = folder.join(FRESH_CHECKPOINT_FILE);
        let text = serde_json::to_string(self)
            .map_err(|error| OutputError::malformed(&path, error.to_string()))?;
        fs::write(&fresh, text + "\n")
            .and_then(|()| fs::rename(&fresh, &path))
            .map_err(OutputError::unwritten(&path, "cannot write"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Any finite numbers come back with the same bits: zeros of both signs, subnormals, numbers with a long tail.
    #[test]
    fn checkpoint_round_trip_is_exact() {
        let folder = tempfile::tempdir().unwrap();
        assert!(Checkpoint::read(folder.path()).unwrap().is_none());
        let mut bits = 1_u64;
        let mut number = || {
            bits = bits.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            match bits >> 61 {
                0 => 0.0,
                1 => -0.0,
                2 => f64::from_bits(bits >> 13),
                _ => f64::from_bits((bits & !(0x7FF << 52)) | ((bits >> 54) + 500) << 52),
            }
        };
        let mut vectors = |n: usize| -> Vec<Vector3<f64>> {
            (0..n).map(|_| Vector3::from_fn(|_, _| number())).collect()
        };
        let n = 200;
        let state = State {
            configuration: Configuration {
                positions: vectors(n),
                rotations: (0..n).map(|_| Matrix3::from_columns(&vectors(3))).collect(),
            },
            linear_momentum: vectors(n),
            angular_momentum: vectors(n),
        };
        let written = Checkpoint::new(12345, 0.1 + 0.2, &state, "[rod]\n");
        written.write(folder.path()).unwrap();
        let read = Checkpoint::read(folder.path()).unwrap().unwrap();
        assert_eq!(
            (read.step, read.step_s.to_bits()),
            (12345, (0.1f64 + 0.2).to_bits())
        );
        // Unlike `==`, this tells the two zeros apart.
        assert_eq!(format!("{:?}", read.state()), format!("{state:?}"));
    }

    /// A checkpoint of another version, one that breaks off, and one of uneven arrays are refused by name.
    #[test]
    fn foreign_checkpoints_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let state = State::at_rest(Configuration {
            positions: vec![Vector3::zeros(); 2],
            rotations: vec![Matrix3::identity(); 2],
        });
        let good = serde_json::to_string(&Checkpoint::new(1, 0.1, &state, "")).unwrap();
        let version = format!("\"{}\"", env!("CARGO_PKG_VERSION"));
        for (text, word) in [
            (good.replace(&version, "\"0.0.0\""), "softarm 0.0.0"),
            (good[..good.len() / 2].to_string(), "not a checkpoint"),
            (
                good.replace("\"x\":[[0.0,0.0,0.0],", "\"x\":["),
                "one length",
            ),
        ] {
            assert_ne!(text, good);
            fs::write(folder.path().join(CHECKPOINT_FILE), text).unwrap();
            let error = Checkpoint::read(folder.path()).unwrap_err().to_string();
            assert!(
                error.contains(word) && error.contains(CHECKPOINT_FILE),
                "{error}"
            );
        }
    }
}
