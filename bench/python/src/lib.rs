//! strat for Python: the extension module `strat._strat` behind the package `strat`.
//!
//! It hands arrays to the one pipeline of `bench` and rows back ([`evaluate`], [`run`], [`rows`]), reads
//! prepared sets for training ([`set`]) and runs the commands `prep` and `bench` ([`commands`]). What users
//! see, with docstrings and types, is the Python of `python/strat`, which also turns whatever they have
//! into arrays. Not here: any number; all are made by `strat-bench` and `strat-metrics`.

// What PyO3's macros write for a class or a function crosses into C. No line of ours does.
#![allow(unsafe_code)]

mod arrays;
mod commands;
mod errors;
mod evaluate;
mod prefetch;
mod rows;
mod run;
mod set;

use pyo3::prelude::*;

/// The allocator of `prep` and `bench`, for the same reason.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

#[pymodule]
fn _strat(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add("__version__", env!("CARGO_PKG_VERSION"))?;
    module.add_function(wrap_pyfunction!(commands::run_command, module)?)?;
    module.add_function(wrap_pyfunction!(evaluate::evaluate, module)?)?;
    module.add_function(wrap_pyfunction!(evaluate::protocols, module)?)?;
    module.add_function(wrap_pyfunction!(evaluate::describe, module)?)?;
    module.add_function(wrap_pyfunction!(rows::read_rows, module)?)?;
    module.add_function(wrap_pyfunction!(rows::merge_rows, module)?)?;
    module.add_class::<rows::Rows>()?;
    module.add_class::<run::Run>()?;
    module.add_class::<run::Images>()?;
    module.add_class::<set::Set>()?;
    Ok(())
}
