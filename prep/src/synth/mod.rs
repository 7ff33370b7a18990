//! `prep synth`: a procedural street world, ray cast, written in KITTI's own layouts.
//!
//! Every drive is a street of its own ([`world`]): carriageway, pavements, houses, trees,
//! vehicles and people placed by the hash of the drive's name and a seed. The same rays
//! make the stereo pictures ([`sensors::picture`]), the laser scans ([`sensors::lidar`]) and the disparities
//! and labels ([`truth`]), so that all of them agree. Files go where KITTI has them
//! (PROTOCOL 1.1-1.3), under the names of real drives and frames ([`preset`]); every
//! reader of the project is used on them unchanged. The same preset and seed give the
//! same bytes for any number of threads.
//!
//! It is a stand-in for testing and demonstration: no figure obtained on it says
//! anything about KITTI.

mod geometry;
mod noise;
mod objects;
mod output;
mod preset;
mod random;
mod render;
mod scene;
mod sensors;
mod shading;
#[cfg(test)]
mod tests;
mod truth;
mod vector;
mod world;

use std::path::PathBuf;
use std::sync::Mutex;

use rayon::prelude::*;
use strat_store::progress::Progress;
use strat_store::signals::Watch;
use strat_store::threads;

use crate::error::Result;
use output::WorldFile;
use preset::Shot;
pub use preset::{Preset, View};
pub use render::{Rendered, RenderedTruth, Renderer};

/// What to render and where.
#[derive(Clone, Debug)]
pub struct Options {
    /// How much.
    pub preset: Preset,
    /// Another seed gives another world.
    pub seed: u64,
    /// Threads to use; 0 for one for each core.
    pub threads: usize,
    /// Show no progress.
    pub quiet: bool,
    /// Folder to write to; what is already there is not rendered again.
    pub out: PathBuf,
}

/// Renders what is missing of a preset.
///
/// Returns the exit code: 0 when everything is there, 1 when some frames failed (each is
/// named on stderr, the others are kept).
///
/// # Errors
/// The folder holds another world or cannot be written to, or threads cannot be started.
pub fn run(options: &Options) -> Result<u8> {
    let shots = preset::shots(options.preset);
    output::claim(
        &options.out,
        &WorldFile::new(options.preset, options.seed, shots.len()),
    )?;
    let pool = threads::pool("synth", options.threads)?;
    let missing: Vec<&Shot> = shots
        .iter()
        .filter(|shot| !output::is_there(&options.out, shot))
        .collect();
    let renderer = Renderer::of(options.preset, options.seed);
    let progress = Progress::new("synth", missing.len() as u64, "frames", options.quiet);
    let failures = Mutex::new(Vec::new());
    let watch = Watch::new("stopping after the frames that are being rendered");
    pool.install(|| {
        missing.par_iter().for_each(|shot| {
            if watch.told() {
                return;
            }
            if let Err(error) = output::write(&options.out, shot, &renderer.shoot(shot)) {
                let line = format!("{} frame {}: {error}", shot.world, shot.index);
                progress.println(&line);
                failures
                    .lock()
                    .unwrap_or_else(std::sync::PoisonError::into_inner)
                    .push(line);
            }
            progress.add(1);
        });
    });
    progress.finish();
    watch.check()?;
    let failed = failures
        .into_inner()
        .unwrap_or_else(std::sync::PoisonError::into_inner)
        .len();
    if failed > 0 {
        progress.println(&format!(
            "{failed} of {} frames failed; run the same command again to render what is missing.",
            shots.len()
        ));
        return Ok(1);
    }
    Ok(0)
}
