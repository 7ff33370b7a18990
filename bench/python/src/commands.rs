//! The commands `prep` and `bench` inside of Python.

use std::ffi::OsString;

use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use strat_bench::runtime::process;

/// Runs `prep` or `bench` with its arguments, results on stdout and messages on stderr, and returns
/// the exit code. `script` is the command line of the script, up to the command; `bench` starts it for
/// each model.
#[pyfunction]
pub fn run_command(
    py: Python<'_>,
    mut script: Vec<OsString>,
    command: &str,
    arguments: Vec<OsString>,
) -> PyResult<u8> {
    let main: fn(Vec<OsString>) -> u8 = match command {
        "prep" => |line| strat_prep::cli::main(line),
        "bench" => |line| strat_bench::cli::main(line),
        _ => {
            return Err(PyValueError::new_err(format!(
                "unknown command \"{command}\"; this package has prep and bench"
            )));
        }
    };
    strat_store::signals::tell_size_limits();
    script.push(command.into());
    process::is_served_by(script);
    let mut line = vec![OsString::from(format!("strat {command}"))];
    line.extend(arguments);
    Ok(py.detach(|| main(line)))
}
