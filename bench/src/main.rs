//! The `bench` command; see [`strat_bench::cli`].

use std::process::ExitCode;

#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

fn main() -> ExitCode {
    strat_store::signals::tell_size_limits();
    strat_bench::runtime::process::is_served_here();
    ExitCode::from(strat_bench::cli::main(std::env::args_os()))
}
