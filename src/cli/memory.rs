//! Refuses a verb that needs more memory than the system can give.

use super::error::CliError;
use crate::memory::{MemoryEstimate, available};
use crate::scene::SceneSource;

/// Refuses a scene that needs more than the system can give, before the work begins.
pub(super) fn require(estimate: &MemoryEstimate, source: &SceneSource) -> Result<(), CliError> {
    match estimate.refused(available().as_ref()) {
        None => Ok(()),
        Some((key, message, advice)) => Err(source.error_at(key, message, Some(advice)).into()),
    }
}
