//! The files of a result directory: reading and writing.

mod checkpoint;
#[doc(hidden)]
pub mod closed_loop;
mod controls;
mod diagnostics;
mod directory;
mod efforts;
mod end_state;
mod error;
#[cfg(feature = "cli")]
#[doc(hidden)]
pub mod export;
mod extremes;
mod feedback;
mod json;
mod motion;
mod multipliers;
mod npz;
#[cfg(feature = "cli")]
pub(crate) mod quantity;
mod reading;
#[cfg(feature = "cli")]
pub(crate) mod replace;
mod report;
#[cfg(feature = "cli")]
mod residuals;
mod rows;
mod running;
#[doc(hidden)]
pub mod summary;

#[doc(hidden)]
pub use checkpoint::Checkpoint;
#[cfg(feature = "cli")]
pub(crate) use controls::first_line;
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
pub(crate) use json::json_value;
pub use motion::{MotionRecord, ThinnedMotion};
pub use multipliers::{MultiplierRecord, read_multipliers};
#[doc(hidden)]
pub use reading::read_text;
pub(crate) use reading::{Unreadable, open_regular, read_regular};
pub(crate) use report::Columns;
#[doc(hidden)]
pub use report::{
    ArrowKind, Bound, Facts, Hold, ReportArm, ReportArrow, ReportAttempt, ReportBars, ReportChart,
    ReportCheck, ReportClock, ReportCommand, ReportControls, ReportCurve, ReportData, ReportEnergy,
    ReportField, ReportFields, ReportIteration, ReportMark, ReportMotion, ReportObstacle,
    ReportObstacles, ReportPath, ReportRoute, ReportSensitivity, ReportShape, ReportTable,
    ReportTarget, ReportVerdict, ReportVia, Words, figure, render_report,
};
#[cfg(feature = "cli")]
#[doc(hidden)]
pub use report::{
    Compared, ComparedRun, ComparisonData, ComparisonRow, ComparisonTable, PAGE_MARK,
    TradeoffPoint, compare, render_comparison,
};
#[cfg(feature = "cli")]
pub(crate) use report::{PAGE_STYLE, fill, scene_differences};
#[cfg(feature = "cli")]
pub(crate) use residuals::{ResidualRow, read_residuals, write_residuals};
#[doc(hidden)]
pub use rows::{ArrayView, RowFiles, RowPrefix, row_bytes};
#[cfg(feature = "cli")]
pub(crate) use running::JOURNAL_FILE;
#[doc(hidden)]
pub use running::RunDirectory;
