use std::fs::{self, File};
use std::io::{self, Read as _};
use std::path::Path;

use nalgebra::{Matrix3, Vector3};
use serde::{Deserialize, Serialize};

use super::{Extremes, OutputError, RowPrefix};
use mechanics::nodal_state::ORTHONORMAL;
use mechanics::rotation::stray;
use mechanics::{Configuration, State};

/// Name of the checkpoint in a result directory, and in the directory of a run.
pub(super) const CHECKPOINT_FILE: &str = "checkpoint.json";
/// Name of a checkpoint that is being written.
pub(super) const FRESH_CHECKPOINT_FILE: &str = "checkpoint.json.new";
/// Version of the layout of a checkpoint.
const CHECKPOINT_VERSION: u32 = 2;
/// Upper limit of the bytes of a checkpoint besides its scene and its numbers.
const FRAME_BYTES: u64 = 1 << 16;
/// Number of values per node: position, rotation, linear and angular momentum.
const NUMBERS_OF_A_NODE: u64 = 18;
/// Upper limit of the bytes of a number in text, which takes at most 24 characters, with separators.
const BYTES_OF_A_NUMBER: u64 = 32;

/// The data from which a simulation continues as if it had never stopped. Its numbers are exact: they are written with enough digits to
/// read back the same bits. Checksums tell whether the checkpoint and its rows are unchanged.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Checkpoint {
    schema_version: u32,
    /// Version of the program; another one may compute other digits.
    softarm: String,
    /// CRC-32 of the text of this object with 0 in the place of the checksum.
    checksum: u32,
    /// Number of steps taken.
    pub step: usize,
    /// Time step, s.
    pub step_s: f64,
    /// Divisor by which this step is shorter than that of the scene.
    pub divided: usize,
    /// Rows of the trajectory up to this step.
    pub trajectory: RowPrefix,
    /// Rows of the diagnostics, if there are any.
    pub diagnostics: Option<RowPrefix>,
    /// Extremes over every step up to this one.
    pub extremes: Extremes,
    /// The resolved scene, as TOML.
    pub scene: String,
    x: Vec<[f64; 3]>,
    /// Rotation matrices, row by row.
    #[serde(rename = "R")]
    rotation: Vec<[[f64; 3]; 3]>,
    linear_momentum: Vec<[f64; 3]>,
    angular_momentum: Vec<[f64; 3]>,
}

/// The fields that must be known before the rest of a checkpoint can be read.
#[derive(Deserialize)]
struct Head {
    schema_version: u32,
    softarm: String,
}

impl Checkpoint {
    /// Creates a checkpoint after `step` steps of `step_s` seconds in `scene`, with the written rows and the extremes so far.
    pub fn new(
        step: usize,
        (step_s, divided): (f64, usize),
        state: &State,
        scene: &str,
        trajectory: RowPrefix,
        diagnostics: Option<RowPrefix>,
        extremes: Extremes,
    ) -> Self {
        let arrays = |vectors: &[Vector3<f64>]| vectors.iter().map(|&v| v.into()).collect();
        Self {
            schema_version: CHECKPOINT_VERSION,
            softarm: env!("CARGO_PKG_VERSION").into(),
            checksum: 0,
            step,
            step_s,
            divided,
            trajectory,
            diagnostics,
            extremes,
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
        .sealed()
    }

    /// Returns the checkpoint with the checksum of its content.
    fn sealed(mut self) -> Self {
        self.checksum = 0;
        let text = self.text().unwrap_or_default();
        self.checksum = crc32fast::hash(text.as_bytes());
        self
    }

    fn text(&self) -> serde_json::Result<String> {
        let erased: &dyn erased_serde::Serialize = self;
        serde_json::to_string(erased)
    }

    /// Returns the number of nodes of the arm.
    #[must_use]
    pub fn n_nodes(&self) -> usize {
        self.x.len()
    }

    /// Returns the exact state.
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

    /// Tells whether `folder` has a checkpoint.
    #[must_use]
    pub fn is_in(folder: &Path) -> bool {
        folder.join(CHECKPOINT_FILE).exists()
    }

    /// Returns the largest size in bytes of the checkpoint of an arm of `n_nodes` nodes, in a scene whose text has `scene_bytes`.
    #[must_use]
    pub fn most_bytes(n_nodes: usize, scene_bytes: usize) -> u64 {
        // A scene grows when it is resolved, and its lines and quotes take two characters.
        FRAME_BYTES
            + 4 * scene_bytes as u64
            + NUMBERS_OF_A_NODE * BYTES_OF_A_NUMBER * n_nodes as u64
    }

    /// Reads the checkpoint in `folder`, of at most `most_bytes` bytes; `None` if there is none.
    ///
    /// # Errors
    /// Returns [`OutputError::Malformed`] for a path that is not a file, a longer file, a checkpoint of another version or one that was
    /// changed, and for numbers that no simulation writes.
    pub fn read(folder: &Path, most_bytes: u64) -> Result<Option<Self>, OutputError> {
        let path = folder.join(CHECKPOINT_FILE);
        let malformed = |reason: String| OutputError::malformed(&path, reason);
        let cannot_read = || OutputError::io(&path, "cannot read");
        let metadata = match fs::metadata(&path) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(None),
            other => other.map_err(cannot_read())?,
        };
        if !metadata.is_file() {
            return Err(malformed("not a file".into()));
        }
        let mut text = String::new();
        File::open(&path)
            .and_then(|file| file.take(most_bytes + 1).read_to_string(&mut text))
            .map_err(cannot_read())?;
        if text.len() as u64 > most_bytes {
            return Err(malformed(format!(
                "{} bytes, and a checkpoint of this scene takes at most {most_bytes}; start over without --resume",
                metadata.len()
            )));
        }
        Self::parse(&text).map(Some).map_err(malformed)
    }

    /// Parses the checkpoint in `text`, or returns the fault of the text.
    fn parse(text: &str) -> Result<Self, String> {
        let not_one = |error| format!("not a checkpoint: {error}; start over without --resume");
        let head: Head = serde_json::from_str(text).map_err(not_one)?;
        if head.schema_version != CHECKPOINT_VERSION {
            return Err(format!(
                "a checkpoint of layout {}, and this softarm reads layout {CHECKPOINT_VERSION}; start over without --resume",
                head.schema_version
            ));
        }
        let this = env!("CARGO_PKG_VERSION");
        if head.softarm != this {
            return Err(format!(
                "made by softarm {}, and this is {this}, which may compute other digits; start over without --resume",
                head.softarm
            ));
        }
        let checkpoint: Self = serde_json::from_str(text).map_err(not_one)?;
        if checkpoint.clone().sealed().checksum != checkpoint.checksum {
            return Err(
                "its checksum is not that of its content: it was changed after it was written; start over without --resume"
                    .into(),
            );
        }
        checkpoint.validate()?;
        Ok(checkpoint)
    }

    /// Checks that arrays have equal lengths, numbers are finite, and rotations are orthogonal.
    fn validate(&self) -> Result<(), String> {
        let n = self.n_nodes();
        let lengths = [
            self.rotation.len(),
            self.linear_momentum.len(),
            self.angular_momentum.len(),
        ];
        if lengths != [n; 3] {
            return Err("its arrays are not of one length".into());
        }
        if !(self.step_s > 0.0) || !self.step_s.is_finite() {
            return Err(format!("steps of {} s", self.step_s));
        }
        let diagnosed = self
            .diagnostics
            .map_or(self.trajectory.rows, |rows| rows.rows);
        if diagnosed != self.trajectory.rows {
            return Err(format!(
                "{} rows of the trajectory and {diagnosed} of diagnostics",
                self.trajectory.rows
            ));
        }
        for node in 0..n {
            let vectors = [
                self.x[node],
                self.linear_momentum[node],
                self.angular_momentum[node],
            ];
            if !vectors.iter().flatten().all(|value| value.is_finite()) {
                return Err(format!("a number of node {node} is not finite"));
            }
            let rotation = Matrix3::from(self.rotation[node]);
            let stray = stray(&rotation);
            if !(stray <= ORTHONORMAL) {
                return Err(format!(
                    "R of node {node} is not a rotation: off by {stray:.1e}, with determinant {:.3}",
                    rotation.determinant()
                ));
            }
        }
        Ok(())
    }

    /// Replaces the checkpoint in `folder` atomically: a reader finds the old one or this one, complete.
    pub fn write(&self, folder: &Path) -> Result<(), OutputError> {
        let path = folder.join(CHECKPOINT_FILE);
        let fresh = folder.join(FRESH_CHECKPOINT_FILE);
        let text =
            (self.text()).map_err(|error| OutputError::malformed(&path, error.to_string()))?;
        fs::write(&fresh, text + "\n")
            .and_then(|()| fs::rename(&fresh, &path))
            .map_err(OutputError::unwritten(&path, "cannot write"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use serde_json::Value;

    const ANY_SIZE: u64 = 1 << 30;

    /// A state of `n` nodes whose numbers are zeros of both signs, subnormals, and numbers with a long tail; rotations are orthogonal.
    fn state(n: usize) -> State {
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
        let rotations = (0..n)
            .map(|node| {
                let axis = Vector3::new(0.3, 1.0, -0.1 * node as f64);
                *nalgebra::Rotation3::new(axis).matrix()
            })
            .collect();
        State {
            configuration: Configuration {
                positions: vectors(n),
                rotations,
            },
            linear_momentum: vectors(n),
            angular_momentum: vectors(n),
        }
    }

    fn checkpoint(n: usize) -> Checkpoint {
        let rows = RowPrefix {
            rows: 7,
            checksum: 1 << 31,
        };
        let mut extremes = Extremes::EMPTY;
        extremes.energy.include(0.1 + 0.2);
        extremes.include_lengths([(0.7, 0.1), (1.0 / 3.0, 0.1)].into_iter());
        Checkpoint::new(
            12345,
            (0.1 + 0.2, 3),
            &state(n),
            "[rod]\n",
            rows,
            Some(rows),
            extremes,
        )
    }

    /// Any finite numbers are read back with the same bits.
    #[test]
    fn checkpoint_round_trip_is_exact() {
        let folder = tempfile::tempdir().unwrap();
        assert!(Checkpoint::read(folder.path(), ANY_SIZE).unwrap().is_none());
        let written = checkpoint(200);
        written.write(folder.path()).unwrap();
        let read = Checkpoint::read(folder.path(), ANY_SIZE).unwrap().unwrap();
        // Unlike `==`, this distinguishes the two zeros.
        assert_eq!(format!("{read:?}"), format!("{written:?}"));
        assert_eq!(format!("{:?}", read.state()), format!("{:?}", state(200)));
    }

    /// Checkpoints of another version of the program or of the layout, incomplete ones, those with uneven arrays, and those changed in any
    /// field are refused, with the file and the reason.
    #[test]
    fn foreign_checkpoints_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let good = serde_json::to_string(&checkpoint(2)).unwrap();
        let version = format!("\"{}\"", env!("CARGO_PKG_VERSION"));
        for (text, word) in [
            (good.replace(&version, "\"0.0.0\""), "softarm 0.0.0"),
            (
                good.replace("\"schema_version\":2", "\"schema_version\":1"),
                "layout 1, and this softarm reads layout 2",
            ),
            (good[..good.len() / 2].to_string(), "not a checkpoint"),
            (good.replace("\"step\":12345", "\"step\":12346"), "checksum"),
            (good.replace("[rod]", "[rob]"), "checksum"),
            (good.replace("\"rows\":7", "\"rows\":8"), "checksum"),
            (String::new(), "not a checkpoint"),
        ] {
            assert_ne!(text, good);
            fs::write(folder.path().join(CHECKPOINT_FILE), text).unwrap();
            let error = Checkpoint::read(folder.path(), ANY_SIZE).unwrap_err();
            let error = error.to_string();
            assert!(
                error.contains(word) && error.contains(CHECKPOINT_FILE),
                "{error}"
            );
        }
    }

    /// Changes a checkpoint.
    type Change = fn(&mut Checkpoint);

    /// Even with a fitting checksum, numbers that no simulation writes are refused: uneven arrays, a matrix that is not orthogonal, a
    /// reflection, a zero step, rows that do not belong together.
    #[test]
    fn impossible_checkpoints_are_refused() {
        let cases: [(Change, &str); 7] = [
            (|c| c.x.truncate(2), "one length"),
            (|c| c.angular_momentum.truncate(2), "one length"),
            (|c| c.rotation[1][0][0] += 2e-6, "R of node 1"),
            (
                |c| c.rotation[0] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, -1.0]],
                "determinant -1",
            ),
            (|c| c.step_s = 0.0, "steps of 0 s"),
            (|c| c.trajectory.rows = 8, "8 rows"),
            (|c| c.x[1][2] = f64::INFINITY, "not a checkpoint"),
        ];
        for (change, word) in cases {
            let mut changed = checkpoint(3);
            change(&mut changed);
            let text = serde_json::to_string(&changed.sealed()).unwrap();
            let error = Checkpoint::parse(&text).unwrap_err();
            assert!(error.contains(word), "{error}");
        }
    }

    /// A directory, and a file longer than the scene allows, are not read.
    #[test]
    fn the_size_of_a_checkpoint_is_limited() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(CHECKPOINT_FILE);
        let error = || {
            let most = Checkpoint::most_bytes(3, 6);
            Checkpoint::read(folder.path(), most)
                .unwrap_err()
                .to_string()
        };
        fs::create_dir(&path).unwrap();
        assert!(error().contains("not a file"), "{}", error());
        fs::remove_dir(&path).unwrap();
        File::create(&path).unwrap().set_len(1 << 40).unwrap();
        assert!(error().contains("1099511627776 bytes"), "{}", error());

        for n in [1, 200] {
            let text = serde_json::to_string(&checkpoint(n)).unwrap();
            assert!((text.len() as u64) < Checkpoint::most_bytes(n, "[rod]\n".len()));
        }
    }

    /// Collects the paths of all values in an object.
    fn places(value: &Value, path: &str, found: &mut Vec<String>) {
        found.push(path.into());
        match value {
            Value::Object(fields) => {
                for (key, field) in fields {
                    places(field, &format!("{path}/{key}"), found);
                }
            }
            Value::Array(items) => {
                for (i, item) in items.iter().enumerate() {
                    places(item, &format!("{path}/{i}"), found);
                }
            }
            _ => {}
        }
    }

    fn any_value() -> impl Strategy<Value = Value> {
        let number = any::<f64>().prop_map(Value::from); // null, if it is not finite
        prop_oneof![
            Just(Value::Null),
            any::<bool>().prop_map(Value::from),
            any::<u64>().prop_map(Value::from),
            any::<i32>().prop_map(Value::from),
            number.clone(),
            "[ -~]{0,8}".prop_map(Value::from),
            proptest::collection::vec(number, 0..5).prop_map(Value::from),
            Just(serde_json::json!({})),
        ]
    }

    proptest! {
        /// Whatever happens to its bytes, a checkpoint is read back as it was written, or not at all.
        #[test]
        fn damaged_checkpoints_are_refused(
            edits in proptest::collection::vec((any::<prop::sample::Index>(), any::<u8>(), 0..4_u8), 1..6),
        ) {
            let written = checkpoint(3);
            let mut bytes = serde_json::to_vec(&written).unwrap();
            for (place, byte, kind) in edits {
                let at = place.index(bytes.len());
                match kind {
                    0 => bytes[at] = byte,
                    1 => bytes.insert(at, byte),
                    2 => bytes[at] ^= 1 << (byte % 8),
                    _ => bytes.truncate(at.max(1)),
                }
            }
            if let Ok(read) = Checkpoint::parse(&String::from_utf8_lossy(&bytes)) {
                prop_assert_eq!(format!("{read:?}"), format!("{written:?}"));
            }
        }

        /// Whatever replaces a field, a checkpoint is read back as it was written, or not at all; with a forged checksum, as one whose
        /// numbers a simulation can continue from.
        #[test]
        fn tampered_checkpoints_are_refused(place in any::<prop::sample::Index>(), value in any_value()) {
            let written = checkpoint(3);
            let mut fields = serde_json::to_value(&written).unwrap();
            let mut found = Vec::new();
            places(&fields, "", &mut found);
            *fields.pointer_mut(&found[place.index(found.len())]).unwrap() = value;
            if let Ok(read) = Checkpoint::parse(&fields.to_string()) {
                prop_assert_eq!(format!("{read:?}"), format!("{written:?}"));
            }
            if let Ok(tampered) = serde_json::from_value::<Checkpoint>(fields) {
                let text = serde_json::to_string(&tampered.sealed()).unwrap();
                if let Ok(read) = Checkpoint::parse(&text) {
                    let state = read.state();
                    prop_assert_eq!(state.linear_momentum.len(), read.n_nodes());
                    let positions = &state.configuration.positions;
                    prop_assert!(positions.iter().all(|x| x.iter().all(|x| x.is_finite())));
                    for r in &state.configuration.rotations {
                        prop_assert!((r.determinant() - 1.0).abs() < 1e-5);
                    }
                }
            }
        }
    }
}
