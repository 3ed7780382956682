//! Motions for other programs: VTK for ParaView, CSV for everything.

use std::fmt::Write as _;
use std::path::Path;

use nalgebra::Matrix3;

use super::{MotionRecord, OutputError};
use crate::mechanics::rotation::quaternion;

/// A motion as VTK PolyData: one file `NAME-0000.vtp` for every row in `rows`, and `NAME.pvd`, which ParaView opens, with their times.
///
/// Every file has the nodes as points (m) joined by a line, and of every node the radius (m, of an arm that has one) and the three directors,
/// the columns of its rotation. The format is that of the VTK file formats, XML, serial, ASCII.
///
/// # Errors
/// [`OutputError`] where a file cannot be written.
pub fn write_vtk(
    folder: &Path,
    name: &str,
    motion: &MotionRecord,
    radii: &[f64],
    rows: &[usize],
) -> Result<(), OutputError> {
    let mut index = String::from(
        "<?xml version=\"1.0\"?>\n<VTKFile type=\"Collection\" version=\"0.1\" byte_order=\"LittleEndian\">\n<Collection>\n",
    );
    for (number, &row) in rows.iter().enumerate() {
        let file = format!("{name}-{number:04}.vtp");
        let _ = writeln!(
            index,
            "<DataSet timestep=\"{}\" group=\"\" part=\"0\" file=\"{file}\"/>",
            motion.t[row]
        );
        write(&folder.join(&file), &poly_data(motion, radii, row))?;
    }
    index.push_str("</Collection>\n</VTKFile>\n");
    write(&folder.join(format!("{name}.pvd")), &index)
}

fn poly_data(motion: &MotionRecord, radii: &[f64], row: usize) -> String {
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
    format!(
        "<?xml version=\"1.0\"?>\n<VTKFile type=\"PolyData\" version=\"0.1\" byte_order=\"LittleEndian\">\n<PolyData>\n\
         <Piece NumberOfPoints=\"{n}\" NumberOfVerts=\"0\" NumberOfLines=\"1\" NumberOfStrips=\"0\" NumberOfPolys=\"0\">\n\
         <Points>\n{}</Points>\n<PointData{scalars}>\n{data}</PointData>\n\
         <Lines>\n<DataArray type=\"Int64\" Name=\"connectivity\" format=\"ascii\">\n{}\n</DataArray>\n\
         <DataArray type=\"Int64\" Name=\"offsets\" format=\"ascii\">\n{n}\n</DataArray>\n</Lines>\n</Piece>\n</PolyData>\n</VTKFile>\n",
        array("positions", 3, &mut positions.iter().copied()),
        nodes.join(" ")
    )
}

/// A motion as one table: a row for every node at every time of `rows`, with time (s), place along the arm (0 to 1), position (m) and
/// quaternion, scalar first.
///
/// # Errors
/// [`OutputError`] where the file cannot be written.
pub fn write_csv(path: &Path, motion: &MotionRecord, rows: &[usize]) -> Result<(), OutputError> {
    let n = motion.n_nodes;
    let mut text = String::from("t_s,node,s,x_m,y_m,z_m,qw,qx,qy,qz\n");
    for &row in rows {
        for q in 0..n {
            let x = &motion.x[3 * (n * row + q)..][..3];
            let rotation = Matrix3::from_row_slice(&motion.rotation[9 * (n * row + q)..][..9]);
            let turn = quaternion(&rotation);
            let _ = writeln!(
                text,
                "{},{q},{},{},{},{},{},{},{},{}",
                motion.t[row],
                q as f64 / (n - 1) as f64,
                x[0],
                x[1],
                x[2],
                turn.w,
                turn.i,
                turn.j,
                turn.k
            );
        }
    }
    write(path, &text)
}

/// Writes a file beside its place and renames it.
fn write(path: &Path, text: &str) -> Result<(), OutputError> {
    use std::io::Write as _;
    let unwritten = || OutputError::unwritten(path, "cannot write");
    let folder = path.parent().unwrap_or(Path::new("."));
    let mut file = tempfile::NamedTempFile::new_in(folder).map_err(unwritten())?;
    file.write_all(text.as_bytes()).map_err(unwritten())?;
    file.persist(path)
        .map_err(|error| unwritten()(error.error))?;
    Ok(())
}

/// At most `most` rows of `n`, the first and the last among them, as evenly as whole numbers allow.
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
