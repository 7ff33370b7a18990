//! Times the two heavy steps of a preparation on given files, for comparison with other
//! programs (`tests/peers/prep.py` runs it and its own equivalent on the same files).
//!
//! ```text
//! frames images THREADS OUT FILE...       decode, shrink to 512 x 256 by area means, encode as PNG, write
//! frames scans  THREADS OUT DAY FILE...   ground truth of scans with the calibration in DAY, written as raw f32
//! ```
//!
//! `-` as OUT writes nothing. Does the work twice and prints the number of files and the
//! seconds of the second time.
#![allow(clippy::print_stdout, reason = "a tool for the terminal")]

use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::{Context, Result, bail};
use rayon::prelude::*;
use strat_geometry::{CamToCam, DepthAxis, ScanDepth, VeloToCam, velodyne_projection};
use strat_prep::input::source::Source;
use strat_store::inputs::{self, Kind};
use strat_store::resize::{self, Kernel};
use strat_store::{files, image_files};

/// As the command has it.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

fn main() -> Result<()> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let [what, threads, out, rest @ ..] = &args[..] else {
        bail!("usage: frames images|scans THREADS OUT [DAY] FILE...");
    };
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(threads.parse()?)
        .build()?;
    let out = (out != "-").then(|| Path::new(out));
    match what.as_str() {
        "images" => {
            let run = || {
                rest.par_iter()
                    .try_for_each(|file| image(file.as_ref(), out))
            };
            timed(rest.len(), || pool.install(run))
        }
        "scans" => {
            let (day, rest) = rest.split_first().context("a folder with calibration")?;
            let day = Path::new(day);
            let cam = CamToCam::parse(&text(&day.join("calib_cam_to_cam.txt"))?)?;
            let velo = VeloToCam::parse(&text(&day.join("calib_velo_to_cam.txt"))?)?;
            let run = || {
                rest.par_iter()
                    .try_for_each(|file| scan(file.as_ref(), out, &cam, &velo))
            };
            timed(rest.len(), || pool.install(run))
        }
        other => bail!("unknown `{other}`; choose images or scans"),
    }
}

/// The second of two runs: a preparation is long, and memory asked for once is used for all of it.
fn timed(count: usize, run: impl Fn() -> Result<()>) -> Result<()> {
    run()?;
    let start = Instant::now();
    run()?;
    println!("{count} {}", start.elapsed().as_secs_f64());
    Ok(())
}

fn text(path: &Path) -> Result<String> {
    Ok(String::from_utf8_lossy(&inputs::read(path, Kind::Calibration)?).into_owned())
}

fn target(file: &Path, out: &Path, ending: &str) -> Result<PathBuf> {
    let stem = file.file_stem().context("a file has a name")?;
    Ok(out.join(stem).with_extension(ending))
}

fn image(file: &Path, out: Option<&Path>) -> Result<()> {
    let image = image_files::read_rgb(file)?;
    let small = resize::rgb(&image, 512, 256, Kernel::Area);
    let bytes = image_files::encode_png_rgb(&small);
    if let Some(out) = out {
        files::write_atomic(&target(file, out, "png")?, &bytes)?;
    }
    Ok(())
}

fn scan(file: &Path, out: Option<&Path>, cam: &CamToCam, velo: &VeloToCam) -> Result<()> {
    let mut depth = ScanDepth::new(
        &velodyne_projection(cam, velo),
        cam.width as usize,
        cam.height as usize,
        [DepthAxis::VelodyneX],
    );
    Source::File(file.to_owned()).read_in_pieces(|bytes| depth.add(bytes))?;
    let [depth_m] = depth.finish()?;
    if let Some(out) = out {
        let bytes: Vec<u8> = depth_m.iter().flat_map(|d| d.to_le_bytes()).collect();
        files::write_atomic(&target(file, out, "f32")?, &bytes)?;
    }
    Ok(())
}
