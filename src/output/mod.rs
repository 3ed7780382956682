//! What a simulation or an optimal-control solve writes to disk.

mod controls;
mod directory;
mod error;
mod motion;
mod report;
pub mod summary;

pub use controls::{ControlRow, read_controls, write_controls};
pub use directory::ResultDirectory;
pub use error::OutputError;
pub use motion::MotionRecord;
pub use report::{
    Bound, Hold, ReportArm, ReportCheck, ReportCommand, ReportControls, ReportData, ReportEnergy,
    ReportIteration, ReportMotion, ReportTarget, ReportVerdict, render_report,
};
