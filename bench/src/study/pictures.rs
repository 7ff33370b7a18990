//! What the variants of a study make of the same images: the sheets of `bench figures` with the first
//! finished seed of each variant.

use std::path::Path;

use strat_splits::Role;
use strat_store::{files, set::PreparedSet};

use super::measure::{Measuring, StudySet};
use crate::{
    figures::{self, Choice, FigureError, Figures},
    model::{Model, leakage::Tested, vet::vet},
    runtime::Runtime,
};

/// Images that are drawn, spread evenly over the test images.
const SHOWN: usize = 4;

/// Draws the sheets into a folder and returns their names.
///
/// # Errors
/// The set or a model cannot be used, or a sheet not be written.
pub fn write(
    out: &Path,
    set: &StudySet,
    measuring: &Measuring<'_>,
    runtime: &Runtime,
) -> Result<Vec<String>, FigureError> {
    let prepared = PreparedSet::open(&set.data)?;
    let samples = prepared.samples(Role::Test)?;
    let choice = Choice::Evenly(SHOWN);
    let protocol = figures::protocol_for(None, &choice, &prepared, &samples)?;
    let chosen = figures::choose(&choice, &protocol, &prepared, &samples)?;
    let figures = Figures {
        set: &prepared,
        samples: &samples,
        chosen: &chosen,
        protocol: &protocol,
        pool: measuring.pool,
        quiet: measuring.quiet,
    };
    let mut variants: Vec<&str> = Vec::new();
    let mut drawn = Vec::new();
    for run in set.runs.iter().filter(|run| run.is_finished()) {
        if variants.contains(&run.variant.as_str()) {
            continue;
        }
        variants.push(&run.variant);
        let Measuring {
            device, threads, ..
        } = *measuring;
        let mut model = Model::open(&run.name(), &run.model(), runtime, device, threads)?;
        // What there is to say of it was said when it was measured.
        vet(&mut model, Some(Tested::new(&prepared.manifest, &samples)))?;
        drawn.push(figures.of_model(&run.model(), &mut model));
    }
    files::make_folder(out)?;
    figures.write(out, &drawn)
}
