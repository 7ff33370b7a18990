//! Pictures of a prepared set to paste into, with their camera.

use image::RgbImage;
use rayon::prelude::*;
use strat_splits::Role;
use strat_store::{
    set::{Content, PreparedSet, Sample},
    spread,
};

use super::{
    error::CueError,
    experiments::{Ground, THESIS_BACKGROUNDS},
};
use crate::{
    evaluate::{
        SampleError,
        sample::{load_image, load_labels},
    },
    quantity::StereoCamera,
};

/// Baseline of the KITTI protocol, metres (PROTOCOL 3.4).
const KITTI_BASELINE_M: f64 = 0.54;
/// Labels of humans and vehicles (PROTOCOL 1.3).
const FOREGROUND_LABELS: std::ops::RangeInclusive<u8> = 24..=33;

/// A picture to paste into.
#[derive(Clone, Debug)]
pub struct Background {
    /// Image id.
    pub id: String,
    /// The untouched left image.
    pub image: RgbImage,
    /// Its sizes and camera.
    pub ground: Ground,
    /// What depth is made of disparity with.
    pub camera: Option<StereoCamera>,
    /// Share of humans and vehicles where sprites go, where the set has labels.
    pub occupied: Option<f64>,
}

/// Chooses and reads backgrounds: those asked for, else the `count` whose path is freest of humans
/// and vehicles by their labels, else (without labels) `count` evenly spread ones.
///
/// # Errors
/// There are fewer than five, one asked for is missing, or one cannot be read.
pub fn backgrounds(
    set: &PreparedSet,
    ids: &[String],
    count: usize,
    horizon: Option<f64>,
    pool: &rayon::ThreadPool,
) -> Result<Vec<Background>, CueError> {
    let samples: Vec<Sample> = set
        .samples(Role::Test)?
        .into_iter()
        .filter(|sample| sample.left_full.is_some())
        .collect();
    let folder = set.root.display().to_string();
    let few = |found| CueError::TooFewBackgrounds {
        set: folder.clone(),
        found,
        needed: THESIS_BACKGROUNDS,
    };
    if samples.len() < THESIS_BACKGROUNDS {
        return Err(few(samples.len()));
    }
    let failed = |sample: &Sample| {
        let id = sample.id.clone();
        move |source: SampleError| CueError::Background { id, source }
    };
    let content = set.manifest.content;
    let row_of = |sample: &Sample| {
        horizon.unwrap_or_else(|| horizon_row(content, sample.width, sample.height).0)
    };
    let occupied = |sample: &Sample| -> Result<Option<f64>, CueError> {
        if sample.semantic.is_none() {
            return Ok(None);
        }
        let labels = load_labels(set, sample).map_err(failed(sample))?;
        Ok(Some(path_share(&labels, sample, row_of(sample))))
    };
    let chosen: Vec<(&Sample, Option<f64>)> = if ids.is_empty() {
        let shares: Vec<Option<f64>> =
            pool.install(|| samples.par_iter().map(occupied).collect::<Result<_, _>>())?;
        let count = count.min(samples.len());
        let mut order: Vec<usize> = if shares.iter().all(Option::is_some) {
            let mut order: Vec<usize> = (0..samples.len()).collect();
            let share = |index: usize| shares[index].unwrap_or(1.0);
            order.sort_by(|&a, &b| share(a).total_cmp(&share(b)).then(a.cmp(&b)));
            order.truncate(count);
            order
        } else {
            spread::evenly(samples.len(), count).collect()
        };
        order.sort_unstable();
        order
            .into_iter()
            .map(|index| (&samples[index], shares[index]))
            .collect()
    } else {
        let find = |id: &String| {
            samples
                .iter()
                .find(|sample| sample.id == *id)
                .ok_or_else(|| CueError::NoSuchBackground {
                    set: folder.clone(),
                    id: id.clone(),
                })
        };
        ids.iter()
            .map(|id| find(id).and_then(|sample| Ok((sample, occupied(sample)?))))
            .collect::<Result<_, _>>()?
    };
    if chosen.len() < THESIS_BACKGROUNDS {
        return Err(few(chosen.len()));
    }
    let read = |(sample, occupied): &(&Sample, Option<f64>)| {
        let row = row_of(sample);
        // The experiments need ground below the horizon.
        if !(0.0..0.9 * f64::from(sample.height)).contains(&row) {
            return Err(CueError::Horizon {
                id: sample.id.clone(),
                row,
                height: sample.height,
            });
        }
        let image = load_image(set, sample).map_err(failed(sample))?;
        let focal_px = (sample.focal_px > 0.0).then_some(sample.focal_px);
        let baseline_m = match content {
            Content::Kitti | Content::Eigen => KITTI_BASELINE_M,
            _ => sample.baseline_m,
        };
        Ok(Background {
            id: sample.id.clone(),
            image,
            ground: Ground {
                width: sample.width,
                height: sample.height,
                horizon_row: row,
                focal_px,
            },
            camera: focal_px
                .filter(|_| baseline_m > 0.0)
                .map(|focal_px| StereoCamera {
                    focal_px,
                    baseline_m,
                }),
            occupied: *occupied,
        })
    };
    pool.install(|| chosen.par_iter().map(read).collect())
}

/// Share of humans and vehicles in the middle third below the horizon.
fn path_share(labels: &[u8], sample: &Sample, horizon: f64) -> f64 {
    let (width, first) = (sample.width as usize, horizon.max(0.0) as usize);
    let columns = width / 3..2 * width / 3;
    let (mut all, mut taken) = (0_u32, 0_u32);
    for row in labels.chunks_exact(width).skip(first) {
        for label in &row[columns.clone()] {
            all += 1;
            taken += u32::from(FOREGROUND_LABELS.contains(label));
        }
    }
    f64::from(taken) / f64::from(all.max(1))
}

/// Row of the horizon: the principal point of KITTI's cameras (PROTOCOL 1.1), by image width.
///
/// Images of other sizes of a KITTI set are taken for scaled ones of 1242x375. Of other
/// collections nothing is known, and the middle row is returned with `false`.
#[must_use]
pub fn horizon_row(content: Content, width: u32, height: u32) -> (f64, bool) {
    let rows = f64::from(height);
    if content.split().is_none() {
        return (0.5 * (rows - 1.0), false);
    }
    let row = match width {
        1224 => 180.5066,
        1238 => 181.5122,
        1226 => 183.1104,
        1241 => 185.2157,
        _ => 172.854 * rows / 375.0,
    };
    (row, true)
}
