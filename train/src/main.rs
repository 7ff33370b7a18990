//! The `train` command: see [`strat_train::cli`].

use std::process::ExitCode;

fn main() -> ExitCode {
    ExitCode::from(strat_train::cli::main(std::env::args_os()))
}
