//! The `train` command: see [`strat_train::cli`].

use std::process::ExitCode;

#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

fn main() -> ExitCode {
    strat_store::signals::tell_size_limits();
    ExitCode::from(strat_train::cli::main(std::env::args_os()))
}
