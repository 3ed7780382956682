//! Measurements: markers on the arm, its static shapes, and recorded motions, from a TOML file and the tables that it names.

use std::collections::BTreeMap;
use std::path::Path;

use nalgebra::{Matrix3, Quaternion, UnitQuaternion, Vector3};
use serde::Deserialize;

use super::rows::{InputColumn, Rows};
use super::zeros::refuse_zeros;
use crate::output::read_text;

/// Largest file that is read, bytes.
const LARGEST: u64 = 1 << 28;

/// The contents of a file of measurements.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Data {
    /// Standard deviation of the noise of a coordinate, m.
    pub sigma_m: f64,
    /// Standard deviation of the noise of an orientation about each axis, rad.
    pub sigma_rad: Option<f64>,
    /// Markers on the arm.
    #[serde(default)]
    pub marker: Vec<Marker>,
    /// Shapes at rest.
    #[serde(default)]
    pub shape: Vec<Shape>,
    /// Motions from the start of the scene on.
    #[serde(default)]
    pub recording: Vec<Recording>,
    /// Tables of shapes at rest.
    #[serde(default)]
    pub table: Vec<Table>,
    /// Starts, bounds and priors of keys that are fitted.
    #[serde(default)]
    pub free: Vec<Free>,
}

/// A marker that turns with the section to which it is fixed.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Marker {
    /// Name in shapes and recordings.
    pub name: String,
    /// Place on the arm, as a fraction of its length at rest.
    pub at: f64,
    /// Place in the frame of the section, m.
    #[serde(default)]
    pub offset_m: [f64; 3],
}

/// Poses of markers in a shape at rest.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Shape {
    /// Name in the result; the number of the shape, if there is none.
    pub name: Option<String>,
    /// Values of the scene when it was measured, as `KEY=VALUE`.
    #[serde(default)]
    pub set: Vec<String>,
    /// Positions by the name of the marker, m; markers that were not seen are left out.
    #[serde(default)]
    pub positions_m: BTreeMap<String, [f64; 3]>,
    /// Orientations of the sections of markers by their names, as quaternions from the frame of the section to space, scalar first.
    #[serde(default)]
    pub orientations_wxyz: BTreeMap<String, [f64; 4]>,
    /// Tells whether the shape is compared only, and not fitted.
    #[serde(default)]
    pub held_out: bool,
}

/// Poses of markers over time.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Recording {
    /// Name in the result; that of the table, if there is none.
    pub name: Option<String>,
    /// Values of the scene when it was measured, as `KEY=VALUE`.
    #[serde(default)]
    pub set: Vec<String>,
    /// Table beside the file: columns `t_s`, of markers `NAME_x_m`, `NAME_y_m`, `NAME_z_m`, and of the orientations of their sections `NAME_qw`,
    /// `NAME_qx`, `NAME_qy`, `NAME_qz`; empty cells were not seen.
    pub csv: String,
    /// Tells whether the recording is compared only, and not fitted.
    #[serde(default)]
    pub held_out: bool,
}

/// Shapes at rest under many commands: a row for each of them.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Table {
    /// Name in the result; that of the file, if there is none.
    pub name: Option<String>,
    /// Values of the scene in all rows, as `KEY=VALUE`.
    #[serde(default)]
    pub set: Vec<String>,
    /// Table beside the file, with a head of names.
    pub csv: String,
    /// Columns of commands, by their heads.
    pub inputs: BTreeMap<String, InputColumn>,
    /// Columns of the positions of markers, by the names of these.
    pub positions: BTreeMap<String, PositionColumns>,
    /// Head of a column of words by which the result is grouped, such as the pattern of the commands.
    pub by: Option<String>,
    /// Words of that column whose rows are compared only.
    #[serde(default)]
    pub held_out_groups: Vec<String>,
    /// Tells whether all rows are compared only.
    #[serde(default)]
    pub held_out: bool,
    /// Directions in which tendons with friction have slid before they rest; those of the scene, if it is left out.
    pub sliding: Option<SlidingOfRows>,
}

/// Directions in which tendons with friction have slid in the rows of a table.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum SlidingOfRows {
    /// A tendon is pulled or released as its command has last changed in the order of the rows.
    InOrder,
}

/// Three columns of the position of a marker.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PositionColumns {
    /// Heads of the columns of x, y and z.
    pub columns: [String; 3],
    /// Factor from the numbers of the columns to m.
    #[serde(default = "one")]
    pub times: f64,
}

pub fn one() -> f64 {
    1.0
}

/// A key that is fitted.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Free {
    /// Dotted path of a number of the scene, or of a marker, as `marker.tip.offset_m.2`; with `times`, `plus`, `play` or `lag` the name of a number.
    pub key: String,
    /// Dotted paths of numbers to which it is added, in every case those that the case has.
    #[serde(default)]
    pub plus: Vec<String>,
    /// Dotted paths of numbers that the factor multiplies, in every case those that the case has.
    #[serde(default)]
    pub times: Vec<String>,
    /// Keys that rows of tables set, of whose actuators it is the play.
    #[serde(default)]
    pub play: Vec<String>,
    /// Keys of given inputs over time, as `tendon.0.profile`, of whose actuators it is the lag in recordings, s.
    #[serde(default)]
    pub lag: Vec<String>,
    /// Where the search begins; the value of the scene, or 1 of a factor, if it is left out.
    pub start: Option<f64>,
    /// Least value.
    pub lower: Option<f64>,
    /// Largest value.
    pub upper: Option<f64>,
    /// Value known beforehand.
    pub prior: Option<f64>,
    /// Its standard deviation.
    pub prior_sigma: Option<f64>,
}

/// The motion in which an arm was measured.
#[derive(Clone, Debug)]
pub(crate) enum Kind {
    /// None: a shape at rest.
    Shape,
    /// A motion from the start of the scene on.
    Motion,
    /// Many shapes at rest, whose numbers stand for the times of their sights.
    Rows(Rows),
}

/// A measured pose of one marker at one time: its place, its orientation, or both.
#[derive(Clone, Debug)]
pub struct Sight {
    /// Index of the marker.
    pub marker: usize,
    /// Time, s; zero in a shape at rest.
    pub time: f64,
    /// Position, m.
    pub position: Option<Vector3<f64>>,
    /// Rotation from the frame of the section to space.
    pub orientation: Option<Matrix3<f64>>,
}

/// Largest distance of the length of a quaternion from one.
const UNIT: f64 = 1e-2;

/// Returns the rotation of a quaternion, scalar first, whose length is one but for rounding and noise.
fn rotation([w, x, y, z]: [f64; 4]) -> Option<Matrix3<f64>> {
    let quaternion = Quaternion::new(w, x, y, z);
    ((quaternion.norm() - 1.0).abs() <= UNIT).then(|| {
        UnitQuaternion::from_quaternion(quaternion)
            .to_rotation_matrix()
            .into_inner()
    })
}

/// A shape or a recording.
#[derive(Clone, Debug)]
pub struct Case {
    /// Name in results.
    pub name: String,
    /// Values of the scene when it was measured, as `KEY=VALUE`.
    pub set: Vec<String>,
    /// The motion of the arm.
    pub kind: Kind,
    /// Tells whether it is compared only.
    pub held_out: bool,
    /// Number of times at which a position or orientation of a marker is missing in a table.
    pub gaps: usize,
    /// Poses of markers that were seen, in the order of time.
    pub sights: Vec<Sight>,
}

impl Case {
    /// Tells whether it is one shape at rest.
    pub fn is_static(&self) -> bool {
        matches!(self.kind, Kind::Shape)
    }

    /// Tells whether the arm moves.
    pub fn is_motion(&self) -> bool {
        matches!(self.kind, Kind::Motion)
    }

    /// Returns the commands of a table of shapes.
    pub fn rows(&self) -> Option<&Rows> {
        match &self.kind {
            Kind::Rows(rows) => Some(rows),
            Kind::Shape | Kind::Motion => None,
        }
    }

    /// Returns the number of positions and orientations that were seen.
    pub fn n_seen(&self) -> usize {
        let sights = self.sights.iter();
        let seen = |sight: &Sight| {
            usize::from(sight.position.is_some()) + usize::from(sight.orientation.is_some())
        };
        sights.map(seen).sum()
    }
}

/// Reads a file of measurements, and the tables that it names.
///
/// # Errors
/// Returns a sentence with file, place and remedy.
pub fn read(path: &Path) -> Result<(Data, Vec<Case>), String> {
    let text = text_of(path)?;
    let data: Data = toml::from_str(&text).map_err(|error| {
        format!(
            "{}: {error}docs/fitting.md has the form of the file",
            path.display()
        )
    })?;
    let file = File { path, data: &data };
    file.check()?;
    let mut cases = Vec::new();
    for (index, shape) in data.shape.iter().enumerate() {
        cases.push(file.shape_case(index, shape)?);
    }
    for recording in &data.recording {
        cases.push(file.recording_case(recording)?);
    }
    for table in &data.table {
        cases.extend(file.table_cases(table)?);
    }
    if !cases
        .iter()
        .any(|case| !case.held_out && !case.sights.is_empty())
    {
        return Err(file.refused(
            "nothing was measured: give [[shape]], [[recording]] or [[table]] with positions of markers",
        ));
    }
    let mut sights = cases.iter().flat_map(|case| &case.sights);
    if data.sigma_rad.is_none() && sights.any(|sight| sight.orientation.is_some()) {
        return Err(file.refused(
            "there are orientations and no sigma_rad: give their standard deviation about an axis in rad",
        ));
    }
    Ok((data, cases))
}

/// A file of measurements, before its cases are read.
struct File<'a> {
    path: &'a Path,
    data: &'a Data,
}

impl File<'_> {
    fn refused(&self, words: &str) -> String {
        format!("{}: {words}", self.path.display())
    }

    /// Checks standard deviations and markers.
    fn check(&self) -> Result<(), String> {
        let data = self.data;
        if !(data.sigma_m > 0.0 && data.sigma_m.is_finite()) {
            return Err(self.refused(&format!(
                "sigma_m = {}: give the standard deviation of a coordinate in m, above 0",
                data.sigma_m
            )));
        }
        if let Some(sigma) = data.sigma_rad
            && !(sigma > 0.0 && sigma.is_finite())
        {
            return Err(self.refused(&format!(
                "sigma_rad = {sigma}: give the standard deviation of an orientation about an axis in rad, above 0"
            )));
        }
        for (index, marker) in data.marker.iter().enumerate() {
            let known = data.marker[..index]
                .iter()
                .any(|own| own.name == marker.name);
            if known
                || !(0.0..=1.0).contains(&marker.at)
                || marker.offset_m.iter().any(|x| !x.is_finite())
            {
                return Err(self.refused(&format!(
                    "marker {:?} at {}: give every marker a name of its own, a place from 0 to 1, and a finite offset",
                    marker.name, marker.at
                )));
            }
        }
        Ok(())
    }

    /// Returns the index of the marker of this name.
    fn marker(&self, name: &str) -> Result<usize, String> {
        let markers = &self.data.marker;
        let found = markers.iter().position(|marker| marker.name == name);
        found.ok_or_else(|| {
            let names: Vec<_> = markers.iter().map(|marker| &marker.name).collect();
            self.refused(&format!(
                "there is no marker {name:?}; those of the file are {names:?}"
            ))
        })
    }

    fn shape_case(&self, index: usize, shape: &Shape) -> Result<Case, String> {
        let name = (shape.name.clone()).unwrap_or_else(|| format!("shape {}", index + 1));
        let mut sights = Vec::new();
        let seen = (shape.positions_m.keys()).chain(shape.orientations_wxyz.keys());
        for marker in seen.collect::<std::collections::BTreeSet<_>>() {
            let position = shape.positions_m.get(marker).map(|x| Vector3::from(*x));
            if position.is_some_and(|x| x.iter().any(|x| !x.is_finite())) {
                return Err(
                    self.refused(&format!("{name}: the position of {marker:?} is not finite"))
                );
            }
            let wxyz = shape.orientations_wxyz.get(marker);
            let orientation = wxyz.and_then(|wxyz| rotation(*wxyz));
            if wxyz.is_some() && orientation.is_none() {
                return Err(self.refused(&format!(
                    "{name}: the orientation of {marker:?} is no quaternion of length one"
                )));
            }
            sights.push(Sight {
                marker: self.marker(marker)?,
                time: 0.0,
                position,
                orientation,
            });
        }
        Ok(Case {
            name,
            set: shape.set.clone(),
            kind: Kind::Shape,
            held_out: shape.held_out,
            gaps: 0,
            sights,
        })
    }

    fn recording_case(&self, recording: &Recording) -> Result<Case, String> {
        let folder = self.path.parent().unwrap_or(Path::new(""));
        let table = folder.join(&recording.csv);
        let (sights, gaps) = rows(&table, self.data.sigma_m, &|name| self.marker(name))?;
        Ok(Case {
            name: recording
                .name
                .clone()
                .unwrap_or_else(|| recording.csv.clone()),
            set: recording.set.clone(),
            kind: Kind::Motion,
            held_out: recording.held_out,
            gaps,
            sights,
        })
    }
}

impl File<'_> {
    /// Returns the rows of a table that are fitted, and those that are compared only, as far as there are any.
    fn table_cases(&self, table: &Table) -> Result<Vec<Case>, String> {
        let path = self.path.parent().unwrap_or(Path::new("")).join(&table.csv);
        let sheet = Sheet::read(&path)?;
        let columns = TableColumns::of(self, table, &sheet)?;
        let mut cases = [table.case(false), table.case(true)];
        let mut apart = std::collections::BTreeSet::new();
        for row in sheet.rows() {
            let group = columns.by.map(|by| row.cell(by).to_string());
            let group_apart = (group.as_ref()).filter(|own| table.held_out_groups.contains(own));
            apart.extend(group_apart.cloned());
            let is_apart = table.held_out || group_apart.is_some();
            columns.command(&row, &mut cases)?;
            columns.add(&row, group, &mut cases[usize::from(is_apart)])?;
        }
        for case in &cases {
            let line = |row: f64| case.rows().map_or(0, |rows| rows.lines[row as usize]);
            refuse_zeros(&case.sights, self.data.sigma_m)
                .map_err(|(row, words)| at(&path, line(row), words))?;
        }
        let unknown = (table.held_out_groups.iter()).find(|own| !apart.contains(*own));
        if let Some(group) = unknown {
            return Err(sheet.refused(format!("no row has the group {group:?} of held_out_groups")));
        }
        let seen = cases.into_iter().filter(|case| !case.sights.is_empty());
        Ok(seen.collect())
    }
}

impl Table {
    /// Returns the case of its rows before any is read.
    fn case(&self, held_out: bool) -> Case {
        let name = self.name.as_deref().unwrap_or(&self.csv);
        Case {
            name: match held_out && !self.held_out {
                true => format!("{name}, held out"),
                false => name.into(),
            },
            set: self.set.clone(),
            kind: Kind::Rows(Rows {
                keys: self.inputs.values().map(|own| own.key.clone()).collect(),
                play: self.inputs.values().map(|own| own.play).collect(),
                slides_in_order: self.sliding == Some(SlidingOfRows::InOrder),
                ..Rows::default()
            }),
            held_out,
            gaps: 0,
            sights: Vec::new(),
        }
    }
}

/// The columns of a table of shapes.
struct TableColumns<'a> {
    inputs: Vec<(usize, &'a InputColumn)>,
    /// Marker, columns of its position, and factor.
    markers: Vec<(usize, [usize; 3], f64)>,
    by: Option<usize>,
}

impl<'a> TableColumns<'a> {
    fn of(file: &File, table: &'a Table, sheet: &Sheet) -> Result<Self, String> {
        let mut inputs = Vec::new();
        for (name, input) in &table.inputs {
            if !(input.play >= 0.0 && input.play.is_finite()) {
                let play = input.play;
                return Err(sheet.refused(format!(
                    "{name:?} has play = {play}: give half of the way that is lost where a command turns back, at least 0"
                )));
            }
            inputs.push((sheet.column(name)?, input));
        }
        let mut markers = Vec::new();
        for (name, own) in &table.positions {
            let [x, y, z] = own.columns.each_ref().map(|name| sheet.column(name));
            markers.push((file.marker(name)?, [x?, y?, z?], own.times));
        }
        let by = table.by.as_deref().map(|by| sheet.column(by)).transpose()?;
        if let (None, Some(group)) = (by, table.held_out_groups.first()) {
            return Err(sheet.refused(format!(
                "held_out_groups has {group:?}, and by names no column of groups"
            )));
        }
        Ok(Self {
            inputs,
            markers,
            by,
        })
    }

    /// Adds the commands of a row to the cases of its table.
    fn command(&self, row: &Row, cases: &mut [Case; 2]) -> Result<(), String> {
        for (index, input) in &self.inputs {
            let command = row.number(*index)? * input.times + input.plus;
            for case in cases.iter_mut() {
                if let Kind::Rows(rows) = &mut case.kind {
                    rows.commands.push(command);
                }
            }
        }
        Ok(())
    }

    /// Adds a row, whose commands are the last ones, to a case.
    fn add(&self, row: &Row, group: Option<String>, case: &mut Case) -> Result<(), String> {
        let Kind::Rows(rows) = &mut case.kind else {
            return Ok(());
        };
        let place = rows.commands.len() / self.inputs.len().max(1);
        rows.places.push(place.saturating_sub(1));
        let time = rows.lines.len() as f64;
        rows.lines.push(row.line());
        rows.groups.extend(group);
        for (marker, columns, times) in &self.markers {
            match row.position(columns)? {
                None => case.gaps += 1,
                Some(position) => case.sights.push(Sight {
                    marker: *marker,
                    time,
                    position: Some(position * *times),
                    orientation: None,
                }),
            }
        }
        Ok(())
    }
}

fn text_of(path: &Path) -> Result<String, String> {
    read_text(path, LARGEST).map_err(|error| error.to_string())
}

/// Ends of the names of the columns of a marker: those of its position, and those of the orientation of its section.
const PARTS: [&[&str]; 2] = [&["_x_m", "_y_m", "_z_m"], &["_qw", "_qx", "_qy", "_qz"]];

/// Places of the columns of a marker.
#[derive(Default)]
struct Columns {
    marker: usize,
    position: Option<[usize; 3]>,
    orientation: Option<[usize; 4]>,
}

/// Words of a cell that was not seen.
const MISSING: [&str; 5] = ["", "nan", "na", "null", "none"];
/// Largest time of a recording, s, eleven days: later ones are those of a clock.
const LATEST: f64 = 1e6;

/// Reads the table of a recording: what was seen, and the number of gaps.
fn rows(
    path: &Path,
    sigma: f64,
    marker_of: &dyn Fn(&str) -> Result<usize, String>,
) -> Result<(Vec<Sight>, usize), String> {
    let sheet = Sheet::read(path)?;
    let head = Head::of(&sheet, marker_of)?;
    let mut sights = Vec::new();
    let mut gaps = 0;
    let mut before = f64::NEG_INFINITY;
    for row in sheet.rows() {
        let time = row.time(head.time, before)?;
        before = time;
        for own in &head.markers {
            let sight = row.sight(own, time)?;
            gaps += usize::from(own.position.is_some() && sight.position.is_none())
                + usize::from(own.orientation.is_some() && sight.orientation.is_none());
            if sight.position.is_some() || sight.orientation.is_some() {
                sights.push(sight);
            }
        }
    }
    refuse_zeros(&sights, sigma)
        .map_err(|(t, words)| format!("{}, t_s = {t}: {words}", path.display()))?;
    Ok((sights, gaps))
}

/// A table of a file: the names of its columns, and its rows as text.
struct Sheet<'a> {
    path: &'a Path,
    names: csv::StringRecord,
    records: Vec<csv::StringRecord>,
}

impl<'a> Sheet<'a> {
    fn read(path: &'a Path) -> Result<Self, String> {
        let text = text_of(path)?;
        let mut reader = csv::ReaderBuilder::new()
            .comment(Some(b'#'))
            .trim(csv::Trim::All)
            .from_reader(text.as_bytes());
        let names = reader
            .headers()
            .map_err(|error| at(path, 1, error))?
            .clone();
        let records: Result<_, _> = reader.records().collect();
        Ok(Self {
            path,
            names,
            records: records.map_err(|error| format!("{}: {error}", path.display()))?,
        })
    }

    /// Returns a complaint about the names of the columns.
    fn refused(&self, words: String) -> String {
        at(self.path, 1, words)
    }

    fn column(&self, name: &str) -> Result<usize, String> {
        let found = self.names.iter().position(|head| head == name);
        found.ok_or_else(|| self.refused(format!("there is no column {name:?}")))
    }

    fn rows(&self) -> impl Iterator<Item = Row<'_>> {
        self.records.iter().map(|record| Row {
            sheet: self,
            record,
        })
    }
}

/// Returns a complaint about a line of a table.
fn at(path: &Path, line: u64, words: impl std::fmt::Display) -> String {
    format!("{}, line {line}: {words}", path.display())
}

/// The columns of the table of a recording.
struct Head {
    /// Column of the time.
    time: usize,
    markers: Vec<Columns>,
}

impl Head {
    fn of(
        sheet: &Sheet,
        marker_of: &dyn Fn(&str) -> Result<usize, String>,
    ) -> Result<Self, String> {
        let names = &sheet.names;
        let refused = |words: String| sheet.refused(words);
        let column = |name: &str| names.iter().position(|head| head == name);
        let Some(time) = column("t_s") else {
            return Err(refused("there is no column t_s".into()));
        };
        let mut markers: Vec<Columns> = Vec::new();
        for (index, head) in names.iter().enumerate().filter(|(index, _)| *index != time) {
            let Some((name, ends)) =
                (PARTS.iter()).find_map(|ends| Some((head.strip_suffix(ends[0])?, *ends)))
            else {
                if PARTS
                    .iter()
                    .copied()
                    .flatten()
                    .any(|end| head.ends_with(end))
                {
                    continue;
                }
                return Err(refused(format!(
                    "{head:?} is no column; expected t_s, NAME_x_m, NAME_y_m, NAME_z_m, and NAME_qw, NAME_qx, NAME_qy, NAME_qz"
                )));
            };
            let mut columns = vec![index];
            for end in &ends[1..] {
                let other = format!("{name}{end}");
                let place = column(&other);
                columns.push(place.ok_or_else(|| refused(format!("{head:?} without {other:?}")))?);
            }
            let marker = marker_of(name)?;
            let place = markers
                .iter()
                .position(|own: &Columns| own.marker == marker);
            let place = place.unwrap_or_else(|| {
                markers.push(Columns {
                    marker,
                    ..Columns::default()
                });
                markers.len() - 1
            });
            match columns[..] {
                [x, y, z] => markers[place].position = Some([x, y, z]),
                [w, x, y, z] => markers[place].orientation = Some([w, x, y, z]),
                _ => {}
            }
        }
        Ok(Self { time, markers })
    }
}

/// A row of a table.
struct Row<'a> {
    sheet: &'a Sheet<'a>,
    record: &'a csv::StringRecord,
}

impl Row<'_> {
    /// Returns its line in the file.
    fn line(&self) -> u64 {
        self.record.position().map_or(0, csv::Position::line)
    }

    fn refused(&self, words: String) -> String {
        at(self.sheet.path, self.line(), words)
    }

    fn cell(&self, index: usize) -> &str {
        self.record.get(index).unwrap_or_default()
    }

    fn number(&self, index: usize) -> Result<f64, String> {
        let cell = self.cell(index);
        (cell.parse().ok().filter(|number: &f64| number.is_finite())).ok_or_else(|| {
            self.refused(format!(
                "{cell:?} under {:?} is no number",
                &self.sheet.names[index]
            ))
        })
    }

    /// Tells whether any of these columns has a cell that was seen.
    fn has(&self, columns: &[usize]) -> bool {
        let is_missing = |index: usize| {
            let cell = self.cell(index);
            MISSING.iter().any(|word| cell.eq_ignore_ascii_case(word))
        };
        columns.iter().any(|&index| !is_missing(index))
    }

    /// Returns the time, s, which is later than that of the row before.
    fn time(&self, column: usize, before: f64) -> Result<f64, String> {
        let t = self.number(column)?;
        if !(t >= 0.0 && t > before) {
            return Err(self.refused(format!("t_s = {t}: expected times from 0 s on that grow")));
        }
        if t > LATEST {
            return Err(self.refused(format!(
                "t_s = {t}: times count from the start of the scene, in seconds; subtract the time of the clock at which the motion began"
            )));
        }
        Ok(t)
    }

    /// Returns the position of a marker; `None` if it was not seen.
    fn position(&self, columns: &[usize; 3]) -> Result<Option<Vector3<f64>>, String> {
        if !self.has(columns) {
            return Ok(None);
        }
        let [x, y, z] = columns.map(|index| self.number(index));
        Ok(Some(Vector3::new(x?, y?, z?)))
    }

    /// Returns the pose of a marker at the time of the row, as far as it was seen.
    fn sight(&self, own: &Columns, time: f64) -> Result<Sight, String> {
        let mut sight = Sight {
            marker: own.marker,
            time,
            position: None,
            orientation: None,
        };
        if let Some(columns) = &own.position {
            sight.position = self.position(columns)?;
        }
        if let Some(columns) = own.orientation.filter(|columns| self.has(columns)) {
            let [w, x, y, z] = columns.map(|index| self.number(index));
            let found = rotation([w?, x?, y?, z?]).ok_or_else(|| {
                let head = &self.sheet.names[columns[0]];
                self.refused(format!(
                    "{head:?} and the next are no quaternion of length one; leave the cells of a gap empty"
                ))
            })?;
            sight.orientation = Some(found);
        }
        Ok(sight)
    }
}
