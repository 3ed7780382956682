//! A controller asks for no memory after its first sample.

#![allow(unsafe_code, reason = "an allocator that counts")]

#[path = "common/tracking.rs"]
mod tracking;

use std::alloc::{GlobalAlloc, Layout, System};
use std::sync::atomic::{AtomicUsize, Ordering};

use nalgebra::Vector3;
use softarm::mpc::MpcSettings;

/// Counts what is asked for.
struct Counting;

static COUNT: AtomicUsize = AtomicUsize::new(0);

// SAFETY: every call is passed on to the system's allocator.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        COUNT.fetch_add(1, Ordering::Relaxed);
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// One iteration of Gauss-Newton from a measured state (roll-out, linearization, condensing, subproblem with and without active bounds,
/// step) and the move of the horizon allocate nothing after the first.
#[test]
fn samples_allocate_nothing() {
    for largest_force in [0.5, 1e3] {
        let settings = MpcSettings::receding(0.3);
        let mut controller = tracking::controller(largest_force, &settings);
        let mut state = controller.expected().clone();
        controller.step(&state).unwrap();
        for sample in 0..50 {
            state.clone_from(controller.expected());
            state.linear_momentum[3] += Vector3::new(1e-3, 0.0, -1e-3);
            let before = COUNT.load(Ordering::Relaxed);
            controller.feedback(&state).unwrap();
            let feedback = COUNT.load(Ordering::Relaxed) - before;
            controller.prepare().unwrap();
            let both = COUNT.load(Ordering::Relaxed) - before;
            assert_eq!((feedback, both), (0, 0), "{largest_force} sample {sample}");
        }
        let bounded = controller.record().subproblem.iterations > 0;
        assert_eq!(bounded, largest_force < 1.0);
    }
}
