//! The command-line tool `softarm`; see [`softarm::cli`].

fn main() -> std::process::ExitCode {
    return_freed_memory();
    softarm::cli::run()
}

/// Size in bytes from which an array is mapped separately and returned to the system when it is freed: that of the states of long motions
/// and of a regulator's matrices of fine arms. Smaller arrays are allocated too often for that.
#[cfg(all(target_os = "linux", target_env = "gnu"))]
const MAPPED: i32 = 7 << 18;
/// Bytes of free memory at the end of the heap that are kept.
#[cfg(all(target_os = "linux", target_env = "gnu"))]
const KEPT: i32 = 4 << 20;

/// Fixes two thresholds of the GNU allocator, which otherwise raises them to the largest array that was ever freed, and then keeps half as
/// much memory again as the program ever used at a time.
#[cfg(all(target_os = "linux", target_env = "gnu"))]
#[allow(unsafe_code)]
fn return_freed_memory() {
    // SAFETY: `mallopt` takes two integers by value, refuses values it does not know, and no other thread runs yet.
    unsafe {
        libc::mallopt(libc::M_MMAP_THRESHOLD, MAPPED);
        libc::mallopt(libc::M_TRIM_THRESHOLD, KEPT);
    }
}

/// Leaves other allocators unchanged.
#[cfg(not(all(target_os = "linux", target_env = "gnu")))]
fn return_freed_memory() {}
