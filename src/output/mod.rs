//! The files of a result directory: reading and writing.

mod checkpoint;
#[doc(hidden)]
pub mod closed_loop;
mod controls;
mod diagnostics;
mod directory;
mod error;
#[cfg(feature = "cli")]
#[doc(hidden)]
pub mod export;
mod extremes;
mod feedback;
mod motion;
mod multipliers;
mod npz;
mod reading;
#[cfg(feature = "cli")]
pub(crate) mod replace;
mod report;
mod rows;
mod running;
#[doc(hidden)]
pub mod summary;
#[cfg(feature = "cli")]
#[doc(hidden)]
pub mod tradeoff;

#[doc(hidden)]
pub use checkpoint::Checkpoint;
pub use controls::{ControlRow, read_controls, write_controls};
pub use diagnostics::DiagnosticsRecord;
pub use directory::{ResultDirectory, ResultKind};
pub use error::OutputError;
#[doc(hidden)]
pub use extremes::Extremes;
pub use feedback::{NamedArray, feedback_arrays, read_feedback, write_feedback};
pub use motion::{MotionRecord, ThinnedMotion};
pub use multipliers::{MultiplierRecord, read_multipliers};
#[doc(hidden)]
pub use reading::read_text;
#[doc(hidden)]
pub use report::{
    Bound, Hold, ReportArm, ReportAttempt, ReportChart, ReportCheck, ReportCommand, ReportControls,
    ReportCurve, ReportData, ReportEnergy, ReportIteration, ReportMotion, ReportObstacle,
    ReportObstacles, ReportPath, ReportSensitivity, ReportShape, ReportTarget, ReportVerdict,
    render_report,
};
#[doc(hidden)]
pub use rows::{ArrayView, RowFiles, RowPrefix, row_bytes};
#[doc(hidden)]
pub use running::RunDirectory;
