use std::path::Path;

use nalgebra::Vector3;

use super::npz::{self, read_array, write_array};
use super::{ArrayView, OutputError};
use mechanics::{Energy, State, Wrench};

/// A motion of the arm, sampled at `n` times: the content of `trajectory.npz`.
///
/// All arrays are flat in C order, with `K + 1 = n_nodes` nodes and `K` elements.
#[derive(Debug, Clone, PartialEq)]
pub struct MotionRecord {
    /// Number of nodes of the arm, base to tip, at least two.
    pub n_nodes: usize,
    /// `[n]` times in seconds, in order.
    pub t: Vec<f64>,
    /// `[n, K+1, 3]` positions in meters; `x` in the file.
    pub x: Vec<f64>,
    /// `[n, K+1, 3, 3]` rotations from body to space, row-major; column `i` is director `d_i`; `R` in the file.
    pub rotation: Vec<f64>,
    /// `[n, 3]` control force on the tip, spatial frame, in newtons.
    pub tip_force: Vec<f64>,
    /// `[n, 3]` control moment on the tip, body frame, in newton meters.
    pub tip_moment: Vec<f64>,
    /// `[n, 3]` kinetic, elastic and potential energy in joules.
    pub energy: Vec<f64>,
    /// `[n, K]` current length of each element divided by its rest length.
    pub dilatation: Vec<f64>,
}

impl MotionRecord {
    /// Appends one time: a state, the wrench on the tip, energies in J, and the length of every element divided by that at rest.
    pub fn push_state(
        &mut self,
        t: f64,
        state: &State,
        wrench: &Wrench,
        energy: &Energy,
        dilatation: &[f64],
    ) {
        self.t.push(t);
        for x in &state.configuration.positions {
            self.x.extend_from_slice(x.as_slice());
        }
        for r in &state.configuration.rotations {
            // nalgebra stores columns; the file has rows.
            self.rotation.extend_from_slice(r.transpose().as_slice());
        }
        self.tip_force.extend_from_slice(wrench.force.as_slice());
        self.tip_moment.extend_from_slice(wrench.moment.as_slice());
        self.energy
            .extend([energy.kinetic, energy.elastic, energy.potential]);
        self.dilatation.extend_from_slice(dilatation);
    }

    /// Appends a shape at rest: `number` stands in the place of the time, and the loads of `rod` are those at `time` seconds.
    pub fn push_at_rest(
        &mut self,
        number: f64,
        rod: &mechanics::Rod,
        shape: &mechanics::Configuration,
        time: f64,
    ) {
        let state = State::at_rest(shape.clone());
        let tip = rod.tip();
        let mut wrench = Wrench::default();
        for load in rod.loads.iter().filter(|load| load.node == tip) {
            let acting = load.wrench(time, &shape.rotations[tip]);
            wrench.force += acting.force;
            wrench.moment += acting.moment;
        }
        let energy = Energy::of(rod, &state);
        let dilatation = rod.dilatation(&shape.positions);
        self.push_state(number, &state, &wrench, &energy, &dilatation);
    }

    /// Creates a record without rows.
    pub fn empty(n_nodes: usize) -> Self {
        Self {
            n_nodes,
            t: Vec::new(),
            x: Vec::new(),
            rotation: Vec::new(),
            tip_force: Vec::new(),
            tip_moment: Vec::new(),
            energy: Vec::new(),
            dilatation: Vec::new(),
        }
    }

    /// Returns the position of a node in a row, m.
    pub fn position(&self, row: usize, node: usize) -> Vector3<f64> {
        let at = 3 * (row * self.n_nodes + node);
        Vector3::from_column_slice(&self.x[at..at + 3])
    }

    /// Returns the number of sampled times.
    pub fn n_rows(&self) -> usize {
        self.t.len()
    }

    /// Writes the arrays as a numpy archive; the same record gives the same bytes.
    pub fn write_npz(&self, path: &Path) -> Result<(), OutputError> {
        self.validate(path)?;
        npz::write(path, |archive| {
            self.arrays().iter().try_for_each(|(name, shape, values)| {
                write_array(archive, name, shape, values.iter().copied().map(Ok))
            })
        })
    }

    /// Reads a file of [`write_npz`](Self::write_npz); refuses wrong shapes, missing arrays and non-finite numbers.
    pub fn read_npz(path: &Path) -> Result<Self, OutputError> {
        Self::read(path, npz::open(path)?, None, None)
    }

    /// Reads such a file with `n_rows` rows of `n_nodes` nodes, and no more data than these.
    pub fn read_npz_of(path: &Path, n_rows: usize, n_nodes: usize) -> Result<Self, OutputError> {
        let archive = Self::open_within(path, n_rows, n_nodes)?;
        Self::read(path, archive, Some(n_rows), Some(n_nodes))
    }

    /// Opens an archive that is no larger than one with the given numbers of rows and nodes.
    fn open_within(
        path: &Path,
        n_rows: usize,
        n_nodes: usize,
    ) -> Result<npz::Archive, OutputError> {
        // Numbers per row: time, two vectors, three energies; twelve per node, one per element.
        let per_row = n_nodes.saturating_mul(13).saturating_add(9);
        let mut sizes = [0; 7];
        sizes[0] = n_rows.saturating_mul(per_row);
        npz::open_within(path, npz::largest_archive(&sizes))
    }

    /// Reads the rows `keep(n)`, in increasing order, of the `n ≤ most_rows` rows of `n_nodes` nodes of a file of
    /// [`write_npz`](Self::write_npz); only these are kept in memory.
    ///
    /// # Errors
    /// Returns [`OutputError`] as [`read_npz_of`](Self::read_npz_of) does, and for more rows.
    pub fn read_npz_rows(
        path: &Path,
        most_rows: usize,
        n_nodes: usize,
        keep: impl FnOnce(usize) -> Vec<usize>,
    ) -> Result<Self, OutputError> {
        let mut archive = Self::open_within(path, most_rows, n_nodes)?;
        let malformed = |name: &str, reason: String| {
            OutputError::malformed(path, format!("array {name}: {reason}"))
        };
        let (shape, t) = read_array(&mut archive, "t", &[None]).map_err(|r| malformed("t", r))?;
        let n = shape[0];
        if n > most_rows {
            let reason = format!("{n} rows; scene.toml describes at most {most_rows}");
            return Err(malformed("t", reason));
        }
        let kept = keep(n);
        let mut record = Self::empty(n_nodes);
        record.t = kept.iter().filter_map(|&row| t.get(row).copied()).collect();
        let elements = n_nodes.saturating_sub(1);
        for (name, inner) in [
            ("x", &[n_nodes, 3][..]),
            ("R", &[n_nodes, 3, 3][..]),
            ("tip_force", &[3][..]),
            ("tip_moment", &[3][..]),
            ("energy", &[3][..]),
            ("dilatation", &[elements][..]),
        ] {
            let width: usize = inner.iter().product::<usize>().max(1);
            let expected: Vec<_> = [n].iter().chain(inner).copied().map(Some).collect();
            let mut index = 0;
            let mut values = Vec::new();
            npz::visit_array(&mut archive, name, &expected, |value| {
                if kept.binary_search(&(index / width)).is_ok() {
                    values.push(value);
                }
                index += 1;
                Ok(())
            })
            .map_err(|reason| malformed(name, reason))?;
            match name {
                "x" => record.x = values,
                "R" => record.rotation = values,
                "tip_force" => record.tip_force = values,
                "tip_moment" => record.tip_moment = values,
                "energy" => record.energy = values,
                _ => record.dilatation = values,
            }
        }
        record.validate(path)?;
        Ok(record)
    }

    fn read(
        path: &Path,
        mut archive: npz::Archive,
        n_rows: Option<usize>,
        n_nodes: Option<usize>,
    ) -> Result<Self, OutputError> {
        let mut read = |name: &str, expected: &[Option<usize>]| {
            read_array(&mut archive, name, expected)
                .map_err(|reason| OutputError::malformed(path, format!("array {name}: {reason}")))
        };

        let (shape, t) = read("t", &[n_rows])?;
        let n = Some(shape[0]);
        let (shape, x) = read("x", &[n, n_nodes, Some(3)])?;
        let n_nodes = shape[1];
        let record = Self {
            n_nodes,
            t,
            x,
            rotation: read("R", &[n, Some(n_nodes), Some(3), Some(3)])?.1,
            tip_force: read("tip_force", &[n, Some(3)])?.1,
            tip_moment: read("tip_moment", &[n, Some(3)])?.1,
            energy: read("energy", &[n, Some(3)])?.1,
            dilatation: read("dilatation", &[n, Some(n_nodes.saturating_sub(1))])?.1,
        };
        record.validate(path)?;
        Ok(record)
    }

    /// Returns the numbers of at most `max_rows` rows, evenly spread, including the first and the last.
    ///
    /// A record of two rows or more keeps at least these two.
    pub fn thinned_rows(&self, max_rows: usize) -> Vec<usize> {
        let n = self.n_rows();
        let kept = max_rows.max(2).min(n);
        if kept < 2 {
            return (0..n).collect();
        }
        (0..kept).map(|i| i * (n - 1) / (kept - 1)).collect()
    }

    /// Appends the rows of another record of the same arm.
    fn append(&mut self, other: &Self) {
        for (array, (_, _, values)) in self.arrays_mut().into_iter().zip(other.arrays()) {
            array.extend_from_slice(values);
        }
    }

    /// Keeps rows 0, 2, 4, ...
    fn drop_every_second_row(&mut self) {
        let n = self.n_rows();
        for array in self.arrays_mut() {
            let width = array.len() / n;
            let mut index = 0;
            array.retain(|_| {
                index += 1;
                ((index - 1) / width).is_multiple_of(2)
            });
        }
    }

    /// Returns the arrays in the order of the file.
    pub fn arrays_mut(&mut self) -> [&mut Vec<f64>; 7] {
        [
            &mut self.t,
            &mut self.x,
            &mut self.rotation,
            &mut self.tip_force,
            &mut self.tip_moment,
            &mut self.energy,
            &mut self.dilatation,
        ]
    }

    /// Returns name, shape and values of every array of the file, in the order of the file.
    pub fn arrays(&self) -> [ArrayView<'_>; 7] {
        let n = self.n_rows();
        let nodes = self.n_nodes;
        [
            ("t", vec![n], &self.t),
            ("x", vec![n, nodes, 3], &self.x),
            ("R", vec![n, nodes, 3, 3], &self.rotation),
            ("tip_force", vec![n, 3], &self.tip_force),
            ("tip_moment", vec![n, 3], &self.tip_moment),
            ("energy", vec![n, 3], &self.energy),
            (
                "dilatation",
                vec![n, nodes.saturating_sub(1)],
                &self.dilatation,
            ),
        ]
    }

    /// Checks that sizes agree, every number is finite, and time does not run backward.
    fn validate(&self, path: &Path) -> Result<(), OutputError> {
        let malformed = |reason: String| Err(OutputError::malformed(path, reason));
        if self.n_nodes < 2 {
            return malformed(format!("an arm of {} nodes; needs two", self.n_nodes));
        }
        if self.t.is_empty() {
            return malformed("array t: no rows".into());
        }
        for (name, shape, values) in self.arrays() {
            let size: usize = shape.iter().product();
            if values.len() != size {
                return malformed(format!(
                    "array {name}: {} numbers do not fill the shape {shape:?}",
                    values.len()
                ));
            }
            if let Some(index) = values.iter().position(|value| !value.is_finite()) {
                let row = index * self.n_rows() / size;
                return malformed(format!(
                    "array {name}: {} in row {row}, not a finite number",
                    values[index]
                ));
            }
        }
        if let Some(row) = self.t.windows(2).position(|pair| pair[1] < pair[0]) {
            return malformed(format!(
                "array t: runs backward from {} to {} s after row {row}",
                self.t[row],
                self.t[row + 1]
            ));
        }
        Ok(())
    }
}

/// A thinned motion for pictures: at most [`MOST_ROWS`](Self::MOST_ROWS) rows, and the last one, of a motion of any length, evenly spread.
///
/// Every `stride`-th row is kept; when full, every second of those, and `stride` is doubled.
#[derive(Debug, Clone)]
pub struct ThinnedMotion {
    record: MotionRecord,
    stride: usize,
    n_seen: usize,
}

impl ThinnedMotion {
    /// Number of rows that suffice for a picture and a curve.
    pub const MOST_ROWS: usize = 480;

    /// Creates the thinned motion of an arm of `n_nodes` nodes.
    pub fn new(n_nodes: usize) -> Self {
        Self {
            record: MotionRecord::empty(n_nodes),
            stride: 1,
            n_seen: 0,
        }
    }

    /// Returns the numbers of the kept rows among `n`, and of the last one.
    pub fn rows_of(n: usize) -> Vec<usize> {
        let (mut rows, mut stride) = (Vec::new(), 1);
        for row in 0..n {
            if row % stride == 0 && rows.len() == Self::MOST_ROWS {
                stride *= 2;
                rows.retain(|kept| kept % stride == 0);
            }
            if row % stride == 0 {
                rows.push(row);
            }
        }
        if let Some(last) = n.checked_sub(1)
            && rows.last() != Some(&last)
        {
            rows.push(last);
        }
        rows
    }

    /// Includes the next row: a record of one row.
    pub fn push(&mut self, row: &MotionRecord) {
        if self.n_seen.is_multiple_of(self.stride) {
            if self.record.n_rows() == Self::MOST_ROWS {
                self.record.drop_every_second_row();
                self.stride *= 2;
            }
            if self.n_seen.is_multiple_of(self.stride) {
                self.record.append(row);
            }
        }
        self.n_seen += 1;
    }

    /// Returns the kept rows and the last one, which is `last`.
    pub fn finish(mut self, last: &MotionRecord) -> MotionRecord {
        if self.record.t.last() != last.t.last() {
            self.record.append(last);
        }
        self.record
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::reading::tests::{accidents, damaged};
    use proptest::prelude::*;

    /// A record whose numbers span magnitudes, signs and subnormals.
    pub(crate) fn record(n: usize, n_nodes: usize) -> MotionRecord {
        let mut state = 1_u64;
        let mut numbers = |len: usize| -> Vec<f64> {
            (0..len)
                .map(|_| {
                    state = state
                        .wrapping_mul(6_364_136_223_846_793_005)
                        .wrapping_add(1);
                    let mantissa = (state >> 11) as f64 / (1_u64 << 53) as f64 - 0.5;
                    mantissa * 10_f64.powi((state % 600) as i32 - 320)
                })
                .collect()
        };
        MotionRecord {
            n_nodes,
            t: (0..n).map(|row| row as f64 * 0.1).collect(),
            x: numbers(n * n_nodes * 3),
            rotation: numbers(n * n_nodes * 9),
            tip_force: numbers(n * 3),
            tip_moment: numbers(n * 3),
            energy: numbers(n * 3),
            dilatation: numbers(n * (n_nodes - 1)),
        }
    }

    fn bits(values: &[f64]) -> Vec<u64> {
        values.iter().map(|value| value.to_bits()).collect()
    }

    /// Any finite numbers are read back with the same bits, and the same record gives the same bytes.
    #[test]
    fn npz_round_trip_is_exact() {
        let folder = tempfile::tempdir().unwrap();
        let [first, second] = ["a.npz", "b.npz"].map(|name| folder.path().join(name));
        let record = record(7, 4);
        record.write_npz(&first).unwrap();
        let read = MotionRecord::read_npz(&first).unwrap();
        assert_eq!(read.n_nodes, record.n_nodes);
        for (a, b) in read.arrays().iter().zip(record.arrays()) {
            assert_eq!((a.0, &a.1, bits(a.2)), (b.0, &b.1, bits(b.2)));
        }
        read.write_npz(&second).unwrap();
        assert_eq!(
            std::fs::read(&first).unwrap(),
            std::fs::read(&second).unwrap()
        );
        // Bytes 10 to 13 of the first local header: time and date, 1980-01-01 00:00 in the format of MS-DOS.
        assert_eq!(std::fs::read(&first).unwrap()[10..14], [0, 0, 0x21, 0]);
    }

    /// Records that could not be read back are not written: sizes that disagree, non-finite numbers, time running backward.
    #[test]
    fn inconsistent_records_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("trajectory.npz");
        type Spoil = fn(&mut MotionRecord);
        let cases: [(Spoil, &str); 5] = [
            (|r| r.x.truncate(5), "array x: 5 numbers"),
            (
                |r| r.energy[4] = f64::NAN,
                "array energy: NaN in row 1, not a finite number",
            ),
            (
                |r| r.rotation[0] = f64::INFINITY,
                "array R: inf in row 0, not a finite number",
            ),
            (|r| r.t[2] = 0.0, "array t: runs backward"),
            (|r| r.t.clear(), "array t: no rows"),
        ];
        for (spoil, message) in cases {
            let mut record = record(3, 4);
            spoil(&mut record);
            let error = record.write_npz(&path).unwrap_err().to_string();
            assert!(error.contains(message), "{error}");
            assert!(error.contains("trajectory.npz"), "{error}");
            assert!(!path.exists());
        }
    }

    /// Changes an array of the archive, or leaves it out.
    type Change = fn(&str, &mut Vec<usize>, &mut Vec<f64>) -> bool;

    /// Faulty archives: a missing array, a wrong shape and a NaN are named; an incomplete file, a text file and a missing file are refused.
    #[test]
    fn foreign_archives_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("trajectory.npz");
        let record = record(3, 4);
        let error_after = |change: Change| {
            npz::write(&path, |archive| {
                for (name, mut shape, values) in record.arrays() {
                    let mut values = values.to_vec();
                    if change(name, &mut shape, &mut values) {
                        write_array(archive, name, &shape, values.into_iter().map(Ok))?;
                    }
                }
                Ok(())
            })
            .unwrap();
            MotionRecord::read_npz(&path).unwrap_err().to_string()
        };

        let error = error_after(|name, _, _| name != "dilatation");
        assert!(error.contains("array dilatation: missing"), "{error}");
        let error = error_after(|name, shape, _| {
            if name == "R" {
                *shape = vec![3, 4, 9];
            }
            true
        });
        assert!(
            error.contains("array R: shape [3, 4, 9], not [3, 4, 3, 3]"),
            "{error}"
        );
        let error = error_after(|name, _, values| {
            if name == "tip_force" {
                values[8] = f64::NAN;
            }
            true
        });
        assert!(error.contains("array tip_force: NaN in row 2"), "{error}");

        record.write_npz(&path).unwrap();
        let intact = std::fs::read(&path).unwrap();
        for cut in (0..intact.len()).step_by(13) {
            std::fs::write(&path, &intact[..cut]).unwrap();
            assert!(MotionRecord::read_npz(&path).is_err());
        }
        std::fs::write(&path, "t,x\n").unwrap();
        let error = MotionRecord::read_npz(&path).unwrap_err().to_string();
        assert!(error.contains("not a numpy archive"), "{error}");
        let absent = folder.path().join("absent.npz");
        let error = MotionRecord::read_npz(&absent).unwrap_err();
        assert!(matches!(error, OutputError::Io { .. }), "{error}");
    }

    /// Thinning keeps the first and the last row, at most the requested number, in order and without repetition.
    #[test]
    fn thinning_keeps_both_ends() {
        for (n, max_rows) in [(1, 5), (2, 1), (5, 5), (1000, 240), (241, 240), (7, 0)] {
            let rows = record(n, 2).thinned_rows(max_rows);
            assert_eq!((rows[0], *rows.last().unwrap()), (0, n - 1));
            assert!(rows.len() <= max_rows.max(2));
            assert!(rows.windows(2).all(|pair| pair[0] < pair[1]));
        }
    }

    /// However long the motion is, the thinned one is bounded, evenly spread except for the last step, and has the first and the last row;
    /// a short motion is kept whole.
    #[test]
    fn thinned_motion_is_bounded() {
        for n in [
            1,
            2,
            ThinnedMotion::MOST_ROWS,
            ThinnedMotion::MOST_ROWS + 1,
            5000,
        ] {
            let mut thinned = ThinnedMotion::new(2);
            let mut row = record(1, 2);
            for k in 0..n {
                row.t[0] = k as f64;
                row.dilatation[0] = -(k as f64);
                thinned.push(&row);
            }
            let thinned = thinned.finish(&row);
            assert!(thinned.n_rows() <= ThinnedMotion::MOST_ROWS + 1);
            assert!(thinned.n_rows() >= n.min(ThinnedMotion::MOST_ROWS / 2));
            assert_eq!(
                (thinned.t[0], thinned.t.last()),
                (0.0, Some(&((n - 1) as f64)))
            );
            assert!(
                thinned
                    .dilatation
                    .iter()
                    .zip(&thinned.t)
                    .all(|(e, t)| *e == -t)
            );
            let gaps: Vec<f64> = thinned.t.windows(2).map(|pair| pair[1] - pair[0]).collect();
            assert!(gaps.split_last().is_none_or(|(last, gaps)| {
                gaps.iter().all(|gap| *gap == gaps[0] && last <= gap)
            }));
        }
    }

    /// Archives with false headers: an array of gigabytes of zeros in some kilobytes, a header of four gigabytes, one nested a thousand
    /// levels deep, too many arrays, numbers of four bytes, and column order. All are refused by name, and none is unpacked.
    #[test]
    fn archives_with_false_headers_are_refused() {
        use std::io::Write as _;
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("trajectory.npz");
        let record = record(3, 4);
        let error_with = |t: &[u8]| {
            npz::write(&path, |archive| {
                archive.start_file("t.npy", zip::write::SimpleFileOptions::default())?;
                archive.write_all(t)?;
                for (name, shape, values) in &record.arrays()[1..] {
                    write_array(archive, name, shape, values.iter().copied().map(Ok))?;
                }
                Ok(())
            })
            .unwrap();
            let error = MotionRecord::read_npz_of(&path, 3, 4)
                .unwrap_err()
                .to_string();
            assert!(error.contains("trajectory.npz"), "{error}");
            error
        };
        let array = |header: &str, data: &[u8]| {
            let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
            bytes.extend((header.len() as u16).to_le_bytes());
            bytes.extend(header.as_bytes());
            bytes.extend(data);
            bytes
        };
        let of = |descr: &str, order: &str, shape: &str| {
            format!("{{'descr': '{descr}', 'fortran_order': {order}, 'shape': {shape}, }}")
        };
        let honest: Vec<u8> = (record.t.iter()).flat_map(|t| t.to_le_bytes()).collect();
        let many = vec![0; 5_000_000];
        let error = error_with(&array(&of("<f8", "False", "(625000,)"), &many));
        assert!(error.contains("shape [625000], not [3]"), "{error}");
        let error = error_with(&array(&of("<f8", "False", "(3,)"), &many));
        assert!(error.contains("longer than its shape"), "{error}");
        let error = error_with(b"\x93NUMPY\x02\x00\xff\xff\xff\xff{");
        assert!(error.contains("a header of 4294967295 bytes"), "{error}");
        let error = error_with(&array(&"(".repeat(1000), &honest));
        assert!(error.contains("not an array of plain numbers"), "{error}");
        let error = error_with(&array(&of("<f4", "False", "(3,)"), &honest));
        assert!(error.contains("array t"), "{error}");
        let error = error_with(&array(&of("<f8", "True", "(3, 1)"), &honest));
        assert!(error.contains("shape [3, 1], not [3]"), "{error}");
        let error = error_with(b"\x93NUM");
        assert!(error.contains("breaks off"), "{error}");
        let error = error_with(b"plain text, and long enough");
        assert!(error.contains("not a numpy array"), "{error}");

        npz::write(&path, |archive| {
            (0..65).try_for_each(|i| write_array(archive, &format!("a{i}"), &[1], [Ok(0.0)]))
        })
        .unwrap();
        let error = MotionRecord::read_npz_of(&path, 3, 4)
            .unwrap_err()
            .to_string();
        assert!(error.contains("65 arrays"), "{error}");
        std::fs::write(&path, vec![0; 100_000]).unwrap();
        let error = MotionRecord::read_npz_of(&path, 3, 4)
            .unwrap_err()
            .to_string();
        assert!(error.contains("100000 bytes or more"), "{error}");
    }

    /// Rows read from a file are those that a run keeps while it writes them: the same numbers, whatever their count is.
    #[test]
    fn rows_of_a_file_are_those_that_were_kept() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("trajectory.npz");
        for n in [1, 2, 480, 481, 962, 2000] {
            let whole = record(n, 3);
            whole.write_npz(&path).unwrap();
            let mut thinned = ThinnedMotion::new(3);
            let mut row = MotionRecord::empty(3);
            for i in 0..n {
                row = MotionRecord::empty(3);
                for (to, (_, _, from)) in row.arrays_mut().into_iter().zip(whole.arrays()) {
                    let width = from.len() / n;
                    to.extend_from_slice(&from[i * width..(i + 1) * width]);
                }
                thinned.push(&row);
            }
            let read = MotionRecord::read_npz_rows(&path, n, 3, ThinnedMotion::rows_of).unwrap();
            assert_eq!(read, thinned.finish(&row), "{n}");
            let refused = MotionRecord::read_npz_rows(&path, n - 1, 3, ThinnedMotion::rows_of);
            assert!(refused.is_err(), "{n}");
        }
    }

    proptest! {
        /// Whatever happens to the bytes, reading ends with a record of the requested size or with an error that names the file.
        #[test]
        fn damaged_archives_are_read_or_refused(accidents in accidents()) {
            let folder = tempfile::tempdir().unwrap();
            let path = folder.path().join("trajectory.npz");
            record(3, 4).write_npz(&path).unwrap();
            let bytes = damaged(&std::fs::read(&path).unwrap(), &accidents);
            std::fs::write(&path, bytes).unwrap();
            match MotionRecord::read_npz_of(&path, 3, 4) {
                Ok(record) => prop_assert_eq!([record.n_rows(), record.n_nodes], [3, 4]),
                Err(error) => prop_assert!(error.to_string().contains("trajectory.npz")),
            }
        }
    }
}
