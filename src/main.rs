//! The command-line tool `softarm`; see [`softarm::cli`].

fn main() -> std::process::ExitCode {
    softarm::cli::run()
}
