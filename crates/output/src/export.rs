//! Motions for other programs: VTK for ParaView, CSV for spreadsheets and scripts, SVG for papers and pages.

use std::fmt::Write as _;
use std::fs::{self, File};
use std::io::Read as _;
use std::path::Path;

use nalgebra::Matrix3;

use super::replace::{EXPORT_MARK, HEAD, Own, TABLE_HEAD, Writer};
use super::{EffortRow, MotionRecord, OutputError};
use mechanics::rotation::quaternion;

/// Destination of an export.
#[derive(Clone, Copy, Debug)]
pub struct Destination<'a> {
    /// Existing folder.
    pub folder: &'a Path,
    /// First part of the names of all files.
    pub name: &'a str,
    /// Writer of the files.
    pub writer: &'a Writer,
}

impl Destination<'_> {
    /// Writes files, each of which is computed when it is written, if all of them may be written.
    fn write(&self, files: &[String], text: impl Fn(usize) -> String) -> Result<(), OutputError> {
        let path = |file: &String| self.folder.join(file);
        for file in files {
            self.writer.permit(&path(file), Own::Export)?;
        }
        for (number, file) in files.iter().enumerate() {
            self.writer.write(&path(file), Own::Export, &text(number))?;
        }
        self.remove_beyond(files)
    }

    /// Removes the frames of an earlier export that has more of them: `NAME-NNNN.ENDING` with the endings of these files, if softarm wrote it.
    fn remove_beyond(&self, files: &[String]) -> Result<(), OutputError> {
        let Some(ending) = files.first().and_then(|file| file.rsplit_once('.')) else {
            return Ok(());
        };
        let is_frame = |name: &str| {
            (name.strip_prefix(self.name))
                .and_then(|rest| {
                    rest.strip_prefix('-')?
                        .strip_suffix(ending.1)?
                        .strip_suffix('.')
                })
                .is_some_and(|number| {
                    number.len() >= 4 && number.bytes().all(|digit| digit.is_ascii_digit())
                })
        };
        let cannot = |action| OutputError::unwritten(self.folder, action);
        let folder = fs::read_dir(self.folder).map_err(cannot("cannot look into"))?;
        for entry in folder.flatten() {
            let name = entry.file_name();
            let Some(name) = name.to_str().filter(|name| is_frame(name)) else {
                continue;
            };
            // A frame of a user's own stays, as does what cannot be looked at.
            let path = entry.path();
            let mut head = Vec::new();
            let read = File::open(&path).map(|file| file.take(HEAD).read_to_end(&mut head));
            let is_own =
                matches!(read, Ok(Ok(_))) && String::from_utf8_lossy(&head).contains(EXPORT_MARK);
            if !is_own || files.iter().any(|file| file == name) {
                continue;
            }
            fs::remove_file(&path).map_err(OutputError::unwritten(&path, "cannot remove"))?;
        }
        Ok(())
    }

    /// Returns `count` names `NAME-0000.ENDING` and so on.
    fn numbered(&self, count: usize, ending: &str) -> Vec<String> {
        (0..count)
            .map(|number| format!("{}-{number:04}.{ending}", self.name))
            .collect()
    }
}

/// Writes a motion as VTK PolyData: one file `NAME-0000.vtp` for every row in `rows`, and `NAME.pvd`, which ParaView opens, with their
/// times.
///
/// Every file has the nodes as points (m) joined by a line, and for every node the radius (m, if the arm has one) and the three directors,
/// the columns of its rotation. `efforts` are the rows of `efforts.csv`, all actuators for every row of the motion, or none: the effort and
/// the coordinate of each are field data of its file. The format is that of the VTK file formats, XML, serial, ASCII.
///
/// # Errors
/// Returns [`OutputError`] if a file cannot be written.
pub fn write_vtk(
    to: &Destination,
    motion: &MotionRecord,
    radii: &[f64],
    efforts: &[EffortRow],
    rows: &[usize],
) -> Result<(), OutputError> {
    let mut index = format!(
        "<?xml version=\"1.0\"?>\n{EXPORT_MARK}\n<VTKFile type=\"Collection\" version=\"0.1\" byte_order=\"LittleEndian\">\n<Collection>\n"
    );
    let mut files = to.numbered(rows.len(), "vtp");
    for (file, &row) in files.iter().zip(rows) {
        let _ = writeln!(
            index,
            "<DataSet timestep=\"{}\" group=\"\" part=\"0\" file=\"{file}\"/>",
            motion.t[row]
        );
    }
    index.push_str("</Collection>\n</VTKFile>\n");
    files.push(format!("{}.pvd", to.name));
    to.write(&files, |number| match rows.get(number) {
        Some(&row) => poly_data(motion, radii, efforts_at(motion, efforts, row), row),
        None => index.clone(),
    })
}

/// Returns the efforts in a row of a motion.
fn efforts_at<'a>(motion: &MotionRecord, efforts: &'a [EffortRow], row: usize) -> &'a [EffortRow] {
    let n = efforts.len() / motion.n_rows().max(1);
    &efforts[n * row..][..n]
}

/// Returns a name as the value of an attribute.
fn attribute(name: &str) -> String {
    let escape = |c: char| match c {
        '&' => "&amp;".into(),
        '<' => "&lt;".into(),
        '>' => "&gt;".into(),
        '"' => "&quot;".into(),
        control if control.is_control() => " ".into(),
        plain => plain.to_string(),
    };
    name.chars().map(escape).collect()
}

fn poly_data(motion: &MotionRecord, radii: &[f64], efforts: &[EffortRow], row: usize) -> String {
    let n = motion.n_nodes;
    let positions = &motion.x[3 * n * row..][..3 * n];
    let rotations = &motion.rotation[9 * n * row..][..9 * n];
    let array = |name: &str, components: usize, numbers: &mut dyn Iterator<Item = f64>| {
        let mut text = format!(
            "<DataArray type=\"Float64\" Name=\"{name}\" NumberOfComponents=\"{components}\" format=\"ascii\">\n"
        );
        for (at, number) in numbers.enumerate() {
            let end = if (at + 1) % components == 0 {
                '\n'
            } else {
                ' '
            };
            let _ = write!(text, "{number:e}{end}");
        }
        text.push_str("</DataArray>\n");
        text
    };
    let mut data = String::new();
    if radii.len() == n {
        data += &array("radius", 1, &mut radii.iter().copied());
    }
    for column in 0..3 {
        let director = (0..n)
            .flat_map(|q| (0..3).map(move |i| (q, i)))
            .map(|(q, i)| rotations[9 * q + 3 * i + column]);
        data += &array(&format!("d{}", column + 1), 3, &mut director.into_iter());
    }
    let scalars = if radii.len() == n {
        " Scalars=\"radius\""
    } else {
        ""
    };
    let nodes: Vec<String> = (0..n).map(|q| q.to_string()).collect();
    let mut fields = String::new();
    for own in efforts {
        let name = attribute(&own.name);
        for (word, value) in [("effort", own.effort), ("coordinate", own.coordinate)] {
            let _ = writeln!(
                fields,
                "<DataArray type=\"Float64\" Name=\"{word} {name}\" NumberOfTuples=\"1\" format=\"ascii\">\n{value:e}\n</DataArray>"
            );
        }
    }
    if !fields.is_empty() {
        fields = format!("<FieldData>\n{fields}</FieldData>\n");
    }
    format!(
        "<?xml version=\"1.0\"?>\n{EXPORT_MARK}\n<VTKFile type=\"PolyData\" version=\"0.1\" byte_order=\"LittleEndian\">\n<PolyData>\n{fields}\
         <Piece NumberOfPoints=\"{n}\" NumberOfVerts=\"0\" NumberOfLines=\"1\" NumberOfStrips=\"0\" NumberOfPolys=\"0\">\n\
         <Points>\n{}</Points>\n<PointData{scalars}>\n{data}</PointData>\n\
         <Lines>\n<DataArray type=\"Int64\" Name=\"connectivity\" format=\"ascii\">\n{}\n</DataArray>\n\
         <DataArray type=\"Int64\" Name=\"offsets\" format=\"ascii\">\n{n}\n</DataArray>\n</Lines>\n</Piece>\n</PolyData>\n</VTKFile>\n",
        array("positions", 3, &mut positions.iter().copied()),
        nodes.join(" ")
    )
}

/// Writes a motion as one table: a row for every node at every time of `rows`, with time (s), place along the arm (0 to 1, that of every
/// node is given), position (m) and quaternion, scalar first. `efforts` are the rows of `efforts.csv`, or none: a column each, after the
/// others, with the effort at that time.
///
/// # Errors
/// Returns [`OutputError`] if the file cannot be written.
pub fn write_csv(
    to: &Destination,
    motion: &MotionRecord,
    places: &[f64],
    efforts: &[EffortRow],
    rows: &[usize],
) -> Result<(), OutputError> {
    to.write(&[format!("{}.csv", to.name)], |_| {
        table(motion, places, efforts, rows)
    })
}

fn table(motion: &MotionRecord, places: &[f64], efforts: &[EffortRow], rows: &[usize]) -> String {
    let n = motion.n_nodes;
    let mut text = String::from(TABLE_HEAD);
    for own in efforts_at(motion, efforts, 0) {
        // A name may hold the signs that mean something in a table.
        let _ = write!(text, ",\"effort {}\"", own.name.replace('"', "\"\""));
    }
    text.push('\n');
    for &row in rows {
        let own = efforts_at(motion, efforts, row).iter();
        let own: String = own.map(|own| format!(",{}", own.effort)).collect();
        for q in 0..n {
            let x = &motion.x[3 * (n * row + q)..][..3];
            let rotation = Matrix3::from_row_slice(&motion.rotation[9 * (n * row + q)..][..9]);
            let turn = quaternion(&rotation);
            let _ = writeln!(
                text,
                "{},{q},{},{},{},{},{},{},{},{}{own}",
                motion.t[row], places[q], x[0], x[1], x[2], turn.w, turn.i, turn.j, turn.k
            );
        }
    }
    text
}

/// Returns at most `most` row numbers below `n`, including the first and the last, as evenly spread as whole numbers allow.
#[must_use]
pub fn spread(n: usize, most: usize) -> Vec<usize> {
    let count = n.min(most.max(2));
    if count < 2 {
        return (0..n).collect();
    }
    (0..count)
        .map(|i| (i * (n - 1) + (count - 1) / 2) / (count - 1))
        .collect()
}

/// The direction from which a motion is drawn.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct View {
    /// Angle of the viewpoint about the vertical (z), degrees; 0 looks from +x, -90 from -y, so that x points to the right.
    pub azimuth: f64,
    /// Angle of the viewpoint above the horizontal plane, degrees.
    pub elevation: f64,
    /// Rotation of the viewpoint about the vertical from the first to the last time, degrees.
    pub turn: f64,
}

/// The objects in a drawing that do not move.
#[derive(Clone, Debug, Default)]
pub struct Backdrop {
    /// A target of the tip, m.
    pub target: Option<[f64; 3]>,
    /// Centers (m) and radii (m) of balls.
    pub balls: Vec<([f64; 3], f64)>,
}

/// Width of a drawing, in its own units.
const WIDTH: f64 = 720.0;
/// Margin around the drawn objects, divided by their size.
const MARGIN: f64 = 0.06;
/// Half of the thickness of an arm without radius, divided by its length.
const THIN: f64 = 0.008;

/// Writes a motion as pictures: `NAME-0000.svg` for every row in `rows`, and `NAME.svg`, which plays them repeatedly, in `seconds`.
///
/// The projection is parallel. The arm has its radius; the path of the tip, the target and the balls are drawn behind it.
///
/// # Errors
/// Returns [`OutputError`] if a file cannot be written.
pub fn write_svg(
    to: &Destination,
    motion: &MotionRecord,
    radii: &[f64],
    rows: &[usize],
    (view, seconds): (&View, f64),
    backdrop: &Backdrop,
) -> Result<(), OutputError> {
    let drawing = Drawing::of(motion, radii, rows, view, backdrop);
    let mut files = to.numbered(rows.len(), "svg");
    files.push(format!("{}.svg", to.name));
    to.write(&files, |number| match number < rows.len() {
        true => drawing.still(number),
        false => drawing.animated(seconds),
    })
}

/// One time of a motion, in the plane of the drawing.
struct Frame {
    outline: Vec<[f64; 2]>,
    way: Vec<[f64; 2]>,
    target: Option<[f64; 2]>,
    balls: Vec<([f64; 2], f64)>,
}

struct Drawing {
    frames: Vec<Frame>,
    /// Left, top, width and height, m.
    window: [f64; 4],
}

impl Drawing {
    fn of(
        motion: &MotionRecord,
        radii: &[f64],
        rows: &[usize],
        view: &View,
        backdrop: &Backdrop,
    ) -> Self {
        let n = motion.n_nodes;
        let place = |row: usize, q: usize| {
            let x = &motion.x[3 * (n * row + q)..][..3];
            [x[0], x[1], x[2]]
        };
        let length: f64 = (1..n)
            .map(|q| {
                let (a, b) = (place(0, q - 1), place(0, q));
                (0..3).map(|i| (a[i] - b[i]).powi(2)).sum::<f64>().sqrt()
            })
            .sum();
        let radius = |q: usize| radii.get(q).copied().unwrap_or(THIN * length);
        let last = rows.len().saturating_sub(1).max(1) as f64;
        let frames: Vec<Frame> = (rows.iter().enumerate())
            .map(|(number, &row)| {
                let azimuth = (view.azimuth + view.turn * number as f64 / last).to_radians();
                let elevation = view.elevation.to_radians();
                let seen = |x: [f64; 3]| {
                    let (sine, cosine) = azimuth.sin_cos();
                    let right = cosine * x[1] - sine * x[0];
                    let away = cosine * x[0] + sine * x[1];
                    [right, elevation.sin() * away - elevation.cos() * x[2]]
                };
                let nodes: Vec<[f64; 2]> = (0..n).map(|q| seen(place(row, q))).collect();
                Frame {
                    outline: outline(&nodes, radius),
                    way: rows.iter().map(|&row| seen(place(row, n - 1))).collect(),
                    target: backdrop.target.map(seen),
                    balls: (backdrop.balls.iter())
                        .map(|(center, radius)| (seen(*center), *radius))
                        .collect(),
                }
            })
            .collect();
        let mut low = [f64::INFINITY; 2];
        let mut high = [f64::NEG_INFINITY; 2];
        let mut hold = |point: &[f64; 2], around: f64| {
            for i in 0..2 {
                low[i] = low[i].min(point[i] - around);
                high[i] = high[i].max(point[i] + around);
            }
        };
        for frame in &frames {
            let points = frame.outline.iter().chain(&frame.way).chain(&frame.target);
            points.for_each(|point| hold(point, 0.0));
            for (center, radius) in &frame.balls {
                hold(center, *radius);
            }
        }
        let size = (high[0] - low[0])
            .max(high[1] - low[1])
            .max(f64::MIN_POSITIVE);
        let margin = MARGIN * size;
        Self {
            frames,
            window: [
                low[0] - margin,
                low[1] - margin,
                high[0] - low[0] + 2.0 * margin,
                high[1] - low[1] + 2.0 * margin,
            ],
        }
    }

    fn scale(&self) -> f64 {
        WIDTH / self.window[2].max(self.window[3])
    }

    fn points(&self, points: &[[f64; 2]]) -> String {
        let scale = self.scale();
        let words: Vec<String> = (points.iter())
            .map(|x| {
                let [a, b] = [x[0] - self.window[0], x[1] - self.window[1]];
                format!("{:.1},{:.1}", scale * a, scale * b)
            })
            .collect();
        words.join(" ")
    }

    fn head(&self) -> String {
        let [width, height] = [self.window[2], self.window[3]].map(|m| self.scale() * m);
        format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width:.0} {height:.0}\" width=\"{width:.0}\" height=\"{height:.0}\">\n\
             {EXPORT_MARK}\n<style>.way {{ fill: none; stroke: #c0562b; stroke-width: 1.5 }} .arm {{ fill: #3b7dc4; stroke: #1d4f86; stroke-width: 1.2 }} \
             .ball {{ fill: #8a94a0; fill-opacity: 0.55 }} .target {{ fill: none; stroke: #c0562b; stroke-width: 2.5 }}</style>\n"
        )
    }

    fn backdrop(&self, frame: &Frame) -> String {
        let scale = self.scale();
        let at = |x: &[f64; 2]| [0, 1].map(|i| scale * (x[i] - self.window[i]));
        let mut text = String::new();
        for (center, radius) in &frame.balls {
            let [x, y] = at(center);
            let _ = writeln!(
                text,
                "<circle class=\"ball\" cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"{:.1}\"/>",
                scale * radius
            );
        }
        if let Some(target) = &frame.target {
            let [x, y] = at(target);
            let _ = writeln!(
                text,
                "<circle class=\"target\" cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"9\"/>"
            );
        }
        text
    }

    fn still(&self, number: usize) -> String {
        let frame = &self.frames[number];
        format!(
            "{}{}<polyline class=\"way\" points=\"{}\"/>\n<polygon class=\"arm\" points=\"{}\"/>\n</svg>\n",
            self.head(),
            self.backdrop(frame),
            self.points(&frame.way[..=number]),
            self.points(&frame.outline)
        )
    }

    fn animated(&self, seconds: f64) -> String {
        let Some(first) = self.frames.first() else {
            return self.head() + "</svg>\n";
        };
        let of = |points: &dyn Fn(&Frame) -> String| {
            let values: Vec<String> = self.frames.iter().map(points).collect();
            format!(
                "<animate attributeName=\"points\" dur=\"{seconds:.2}s\" repeatCount=\"indefinite\" values=\"{}\"/>",
                values.join(";")
            )
        };
        format!(
            "{}{}<polyline class=\"way\" points=\"{}\">{}</polyline>\n<polygon class=\"arm\" points=\"{}\">{}</polygon>\n</svg>\n",
            self.head(),
            self.backdrop(first),
            self.points(&first.way),
            of(&|frame| self.points(&frame.way)),
            self.points(&first.outline),
            of(&|frame| self.points(&frame.outline))
        )
    }
}

/// Returns both sides of a line with thickness, one after the other.
fn outline(nodes: &[[f64; 2]], radius: impl Fn(usize) -> f64) -> Vec<[f64; 2]> {
    let n = nodes.len();
    let side = |q: usize, sign: f64| {
        let (a, b) = (nodes[q.saturating_sub(1)], nodes[(q + 1).min(n - 1)]);
        let along = [b[0] - a[0], b[1] - a[1]];
        let norm = along[0].hypot(along[1]).max(f64::MIN_POSITIVE);
        let out = sign * radius(q) / norm;
        [nodes[q][0] - out * along[1], nodes[q][1] + out * along[0]]
    };
    (0..n)
        .map(|q| side(q, 1.0))
        .chain((0..n).rev().map(|q| side(q, -1.0)))
        .collect()
}
