//! The command-line tool `softarm`; see [`softarm::cli`].

fn main() -> std::process::ExitCode {
    return_freed_memory();
    softarm::cli::run()
}

/// Size in bytes from which an array is mapped by itself, and goes back to the system when it is freed: that of the states of long motions
/// and of a regulator's matrices of fine arms. What is smaller comes and goes too often for that.
#[cfg(all(target_os = "linux", target_env = "gnu"))]
const MAPPED: i32 = 7 << 18;
/// Free memory in bytes at the end of the heap that is kept.
#[cfg(all(target_os = "linux", target_env = "gnu"))]
const KEPT: i32 = 4 << 20;

/// Fixes two thresholds of the GNU allocator, which else raises them to the largest array that was ever freed and then keeps half as much again
/// as the program ever used at a time.
#[cfg(all(target_os = "linux", target_env = "gnu"))]
#[allow(unsafe_code)]
fn return_freed_memory() {
    // SAFETY: `mallopt` takes two integers by value, refuses values it does not know, and no other thread runs yet.
    unsafe {
        libc::mallopt(libc::M_MMAP_THRESHOLD, MAPPED);
        libc::mallopt(libc::M_TRIM_THRESHOLD, KEPT);
    }
}

/// Other allocators are left as they are.
#[cfg(not(all(target_os = "linux", target_env = "gnu")))]
fn return_freed_memory() {}
