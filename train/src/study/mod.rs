//! A study: many runs that differ in what is compared and in their seed, as one piece of work.
//!
//! [`file`](mod@file) reads what is asked for, [`plan`] makes a list of runs of it, [`folder`] writes both
//! down, [`state`] looks how far each run is, [`cost`] measures what the rest will take, and [`work`] does it:
//! each run is the `train` command in a process of its own, so that one that fails costs only itself.
//!
//! The folder of a study holds `study.yaml` (what was asked, resolved), `runs.csv` (the runs) and
//! `runs/NAME`, each an ordinary run folder; a run that was made there by hand with the same settings is
//! taken as it is.
//!
//! Not here: what comes out. `bench` evaluates the models and compares the variants.

pub mod cost;
pub mod file;
pub mod folder;
pub mod plan;
pub mod state;
pub mod work;
