//! The memory that is available to this process, which is known on Linux only.

use std::fs;
use std::path::Path;

/// The smallest of all limits.
#[derive(Clone, Debug, PartialEq)]
pub struct Available {
    /// Available memory, bytes.
    pub bytes: f64,
    /// Name of the limit.
    pub by: &'static str,
}

/// Returns the available memory: free memory, and the rest of the limits of the control groups and of the process. `None` if none of them
/// is known.
#[must_use]
pub fn available() -> Option<Available> {
    available_in(Path::new("/proc"), Path::new("/sys/fs/cgroup"))
}

fn available_in(proc: &Path, groups: &Path) -> Option<Available> {
    let read = |name: &str| fs::read_to_string(proc.join(name)).unwrap_or_default();
    let (status, limits) = (read("self/status"), read("self/limits"));
    let under = |limit: &str, used: &str| {
        Some((number_after(&limits, limit)? - KIB * number_after(&status, used)?).max(0.0))
    };
    let found = [
        (
            number_after(&read("meminfo"), "MemAvailable:").map(|free| KIB * free),
            "the system",
        ),
        (
            group_room(groups, &read("self/cgroup")),
            "the control group",
        ),
        (
            under("Max address space", "VmSize:"),
            "the limit of the address space (ulimit -v)",
        ),
        (
            under("Max data size", "VmData:"),
            "the limit of data (ulimit -d)",
        ),
    ];
    (found.into_iter())
        .filter_map(|(bytes, by)| bytes.map(|bytes| Available { bytes, by }))
        .min_by(|a, b| a.bytes.total_cmp(&b.bytes))
}

const KIB: f64 = 1024.0;

/// Returns the number that follows `name` at the beginning of a line; `None` for a limit that is `unlimited`.
fn number_after(text: &str, name: &str) -> Option<f64> {
    let rest = text.lines().find_map(|line| line.strip_prefix(name))?;
    rest.split_whitespace().next()?.parse().ok()
}

/// Returns the memory that the control groups of the process leave, of version 1 and version 2, up to the root.
fn group_room(groups: &Path, membership: &str) -> Option<f64> {
    let of_line = |line: &str| {
        let mut parts = line.splitn(3, ':').skip(1);
        let (controllers, path) = (parts.next()?, parts.next()?);
        let [folder, limit, used] = if controllers.is_empty() {
            ["", "memory.max", "memory.current"]
        } else if controllers.split(',').any(|name| name == "memory") {
            ["memory", "memory.limit_in_bytes", "memory.usage_in_bytes"]
        } else {
            return None;
        };
        let root = groups.join(folder);
        // A container has its own group as the root, where the path leads nowhere.
        let own = root.join(path.trim_start_matches('/'));
        (own.ancestors().take_while(|at| at.starts_with(&root)))
            .filter_map(|at| room(at, limit, used))
            .reduce(f64::min)
    };
    membership.lines().filter_map(of_line).reduce(f64::min)
}

/// Returns the limit of a group minus its use, without the cache of files that the system reclaims first.
fn room(group: &Path, limit: &str, used: &str) -> Option<f64> {
    let read = |name: &str| fs::read_to_string(group.join(name)).ok();
    let number = |name: &str| read(name)?.trim().parse::<f64>().ok();
    let (limit, used) = (number(limit)?, number(used)?);
    let statistics = read("memory.stat").unwrap_or_default();
    let cache = (number_after(&statistics, "total_inactive_file "))
        .or_else(|| number_after(&statistics, "inactive_file "));
    // Version 1 writes the largest number if there is no limit.
    (limit < NO_LIMIT).then(|| (limit - used + cache.unwrap_or(0.0)).max(0.0))
}

/// A limit in bytes that exceeds the memory of any machine.
const NO_LIMIT: f64 = 1e18;

#[cfg(test)]
mod tests {
    use std::path::PathBuf;

    use super::*;

    const MIB: f64 = 1024.0 * 1024.0;

    /// A made-up system: each source in turn, in the words and units of the kernel, is the smallest limit; without any, nothing is known.
    #[test]
    fn the_least_of_all_limits_counts() {
        let folder = tempfile::tempdir().expect("a folder");
        let (proc, groups) = (folder.path().join("proc"), folder.path().join("cgroup"));
        let put = |path: PathBuf, text: &str| {
            fs::create_dir_all(path.parent().expect("a parent")).expect("folders");
            fs::write(path, text).expect("a file");
        };
        let look = || available_in(&proc, &groups).map(|found| (found.bytes / MIB, found.by));
        assert_eq!(look(), None);
        put(
            proc.join("meminfo"),
            "MemTotal: 9 kB\nMemAvailable:    8192 kB\n",
        );
        assert_eq!(look(), Some((8.0, "the system")));
        put(
            proc.join("self/status"),
            "VmSize:\t    1024 kB\nVmData:\t 512 kB\n",
        );
        let unlimited =
            "Max data size             unlimited            unlimited            bytes\n";
        let limited = "Max address space         7340032              unlimited            bytes\n";
        put(proc.join("self/limits"), unlimited);
        assert_eq!(look(), Some((8.0, "the system")));
        put(proc.join("self/limits"), &[unlimited, limited].concat());
        assert_eq!(
            look(),
            Some((6.0, "the limit of the address space (ulimit -v)"))
        );
        put(proc.join("self/cgroup"), "3:cpu:/a\n0::/a/b\n");
        put(groups.join("a/b/memory.max"), "max\n");
        put(groups.join("a/b/memory.current"), "1048576\n");
        assert_eq!(look().map(|found| found.0), Some(6.0));
        put(groups.join("a/memory.max"), "6291456\n");
        put(groups.join("a/memory.current"), "3145728\n");
        assert_eq!(look(), Some((3.0, "the control group")));
        put(
            groups.join("a/memory.stat"),
            "anon 5\ninactive_file 1048576\n",
        );
        assert_eq!(look(), Some((4.0, "the control group")));
        put(proc.join("self/cgroup"), "4:memory,x:/gone/from/here\n");
        put(groups.join("memory/memory.limit_in_bytes"), "2097152\n");
        put(groups.join("memory/memory.usage_in_bytes"), "1048576\n");
        assert_eq!(look(), Some((1.0, "the control group")));
        put(
            groups.join("memory/memory.limit_in_bytes"),
            "9223372036854771712\n",
        );
        assert_eq!(look().map(|found| found.0), Some(6.0));
    }
}
