//! Numbers that check themselves, and defaults of keys.

pub use values::*;

/// Returns true, the default of some keys.
pub(super) fn yes() -> bool {
    true
}

/// Tells whether a key is as it is without being given.
pub(super) fn is_default<T: Default + PartialEq>(value: &T) -> bool {
    *value == T::default()
}
