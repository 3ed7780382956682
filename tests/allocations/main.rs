//! Controllers and estimators allocate nothing after their first sample: this program has an allocator that counts.

#![allow(unsafe_code, reason = "an allocator that counts")]

#[allow(dead_code, reason = "not all of it is used here")]
#[path = "../common/commands.rs"]
mod commands;
#[allow(dead_code, reason = "not all of it is used here")]
#[path = "../common/estimating.rs"]
mod estimating;
#[path = "../common/tracking.rs"]
mod tracking;

mod mpc_estimator_memory;
mod mpc_memory;

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;

/// Counts the allocations of each thread by itself: tests run side by side, and the thread that reports on them allocates as well.
struct Counting;

thread_local! {
    static COUNT: Cell<usize> = const { Cell::new(0) };
}

/// Allocations of the calling thread so far.
fn count() -> usize {
    COUNT.with(Cell::get)
}

// SAFETY: every call is passed on to the system's allocator.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        COUNT.with(|count| count.set(count.get() + 1));
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;
