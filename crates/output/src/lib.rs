//! The files of a result directory: reading and writing.

#![forbid(unsafe_code)]

mod checkpoint;
#[doc(hidden)]
pub mod closed_loop;
mod controls;
mod diagnostics;
mod directory;
mod efforts;
mod end_state;
mod error;
#[doc(hidden)]
pub mod export;
mod extremes;
mod feedback;
mod json;
mod motion;
mod multipliers;
mod npz;
#[doc(hidden)]
pub mod quantity;
mod reading;
#[doc(hidden)]
pub mod replace;
mod report;
mod residuals;
mod rows;
mod running;
#[doc(hidden)]
pub mod summary;

#[doc(hidden)]
pub use checkpoint::Checkpoint;
#[doc(hidden)]
pub use controls::first_line;
pub use controls::{ControlRow, read_controls, write_controls};
pub use diagnostics::{BaseReaction, DiagnosticsRecord};
pub use directory::{ResultDirectory, ResultKind};
pub use efforts::{EffortRow, read_efforts, write_efforts};
pub use end_state::{END_FILE, read_end, write_end};
pub use error::OutputError;
#[doc(hidden)]
pub use extremes::Extremes;
pub use feedback::{
    FeedbackArrays, NamedArray, feedback_arrays, read_feedback, read_sensitivity, write_feedback,
};
#[doc(hidden)]
pub use json::json_value;
pub use motion::{MotionRecord, ThinnedMotion};
pub use multipliers::{MultiplierRecord, read_margins, read_multipliers};
#[doc(hidden)]
pub use reading::read_text;
#[doc(hidden)]
pub use reading::{Unreadable, open_regular, read_regular};
#[doc(hidden)]
pub use report::Columns;
#[doc(hidden)]
pub use report::{
    ArrowKind, Facts, ReportArm, ReportArrow, ReportAttempt, ReportBars, ReportBound, ReportChart,
    ReportCheck, ReportClock, ReportCommand, ReportControls, ReportCurve, ReportData, ReportEnergy,
    ReportField, ReportFields, ReportHold, ReportIteration, ReportMark, ReportMotion,
    ReportObstacle, ReportObstacles, ReportPath, ReportRoute, ReportSensitivity, ReportShape,
    ReportTable, ReportTarget, ReportVerdict, ReportVia, Words, figure, render_report,
};
#[doc(hidden)]
pub use report::{
    Compared, ComparedRun, ComparisonData, ComparisonRow, ComparisonTable, PAGE_MARK,
    TradeoffPoint, compare, render_comparison,
};
#[doc(hidden)]
pub use report::{PAGE_STYLE, entries, fill, scene_differences};
#[doc(hidden)]
pub use residuals::{ResidualRow, read_residuals, write_residuals};
#[doc(hidden)]
pub use rows::{ArrayView, RowFiles, RowPrefix, row_bytes};
#[doc(hidden)]
pub use running::JOURNAL_FILE;
#[doc(hidden)]
pub use running::RunDirectory;
