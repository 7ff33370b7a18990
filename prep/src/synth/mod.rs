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

use anyhow::Context;
use rayon::prelude::*;
use strat_store::progress::Progress;

use output::WorldFile;
use preset::Shot;
pub use preset::{Preset, View};
pub use render::{Rendered, RenderedTruth, Renderer};

/// Arguments of `prep synth`.
#[derive(clap::Args, Clone, Debug)]
pub struct Args {
    /// How much to render.
    #[arg(long, value_enum)]
    pub preset: Preset,
    /// Another seed gives another world.
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// Threads to use [default: all cores].
    #[arg(long)]
    pub jobs: Option<usize>,
    /// Show no progress.
    #[arg(long)]
    pub quiet: bool,
    /// Folder to write to; what is already there is not rendered again.
    #[arg(long)]
    pub out: PathBuf,
}

/// Renders what is missing of a preset.
///
/// Returns the exit code: 0 when everything is there, 1 when some frames failed (each is
/// named on stderr, the others are kept).
///
/// # Errors
/// The folder holds another world or cannot be written to, or threads cannot be started.
pub fn run(args: &Args) -> anyhow::Result<u8> {
    let shots = preset::shots(args.preset);
    output::claim(
        &args.out,
        &WorldFile::new(args.preset, args.seed, shots.len()),
    )?;
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(args.jobs.unwrap_or(0))
        .build()
        .context("The threads for rendering could not be started; try a smaller --jobs.")?;
    let missing: Vec<&Shot> = shots
        .iter()
        .filter(|shot| !output::is_there(&args.out, shot))
        .collect();
    let renderer = Renderer::of(args.preset, args.seed);
    let progress = Progress::new("synth", missing.len() as u64, "frames", args.quiet);
    let failures = Mutex::new(Vec::new());
    pool.install(|| {
        missing.par_iter().for_each(|shot| {
            let written = renderer
                .shoot(shot)
                .and_then(|rendered| output::write(&args.out, shot, &rendered));
            if let Err(error) = written {
                let line = format!("{} frame {}: {error:#}", shot.world, shot.index);
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
