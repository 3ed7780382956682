//! Aligned memory for the vectorized kernels.

use std::ops::{Deref, DerefMut};

/// Numbers that start on a cache line, so that no vector crosses a line.
#[derive(Debug)]
pub struct Buffer {
    store: Vec<f64>,
    start: usize,
    len: usize,
}

impl Buffer {
    /// Memory of so many numbers, all 0.
    #[inline]
    #[must_use]
    pub fn zeros(len: usize) -> Self {
        const LINE: usize = 64;
        let store = vec![0.0; len + LINE / size_of::<f64>()];
        let start = store.as_ptr().align_offset(LINE).min(store.len() - len);
        Self { store, start, len }
    }
}

impl Deref for Buffer {
    type Target = [f64];

    #[inline]
    fn deref(&self) -> &[f64] {
        &self.store[self.start..][..self.len]
    }
}

impl DerefMut for Buffer {
    #[inline]
    fn deref_mut(&mut self) -> &mut [f64] {
        &mut self.store[self.start..][..self.len]
    }
}

impl Clone for Buffer {
    /// Copies into new aligned memory, which may begin at another offset.
    fn clone(&self) -> Self {
        let mut copy = Self::zeros(self.len);
        copy.copy_from_slice(self);
        copy
    }
}
