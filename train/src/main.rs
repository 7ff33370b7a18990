//! The `train` command: see [`strat_train::cli`].

use std::process::ExitCode;

fn main() -> ExitCode {
    strat_store::signals::tell_size_limits();
    ExitCode::from(strat_train::cli::main(std::env::args_os()))
}
