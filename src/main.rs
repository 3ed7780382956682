//! The command-line tool `softarm`; see [`softarm::cli`].

#![forbid(unsafe_code)]

fn main() -> std::process::ExitCode {
    softarm::cli::run()
}
