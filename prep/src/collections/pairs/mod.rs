//! A user's own rectified stereo pairs, or images with ground truth alone, as a prepared set.
//!
//! One CSV file names them ([`list`]): `left`, `right`, `focal_px` (pixels of the left image) and
//! `baseline_m` (metres); `id`, `split` and one of `depth` and `disparity` with `depth_scale`,
//! `invalid` and `disparity_offset_px` are optional. Where `right` is empty an image stands alone: it
//! needs ground truth, is tested on, and its camera may be unknown. Ground truth may be a 16-bit PNG,
//! `.npy` or `.exr`; it becomes depth in metres along the optical axis at the image's own size. Pairs
//! that are not rectified are not recognised.

pub mod list;

use std::collections::BTreeMap;
use std::path::Path;
use std::time::SystemTime;

use strat_geometry::depth_from_disparity_px;
use strat_splits::Role;
use strat_store::exr::{self, DepthHeader};
use strat_store::image_files;
use strat_store::inputs::{self, Kind};
use strat_store::layout::{self, DepthKind, Side};
use strat_store::npy::{self, Array};
use strat_store::raster::Plane;
use strat_store::set::{Content, FileRef, Sample};

pub use self::list::Shares;
use self::list::{Row, Table, Truth};
use super::{Frames, build, measured};
use crate::error::{Error, Result};
use crate::input::source::Source;
use crate::set::files::{Doubt, SetFiles};
use crate::set::results::Failure;
use crate::set::sample::{Frame, SampleError, SampleResult, same_size};
use crate::set::writer::{Report, SetOptions};

/// Values of 16-bit PNG per metre or pixel, as KITTI stores them.
const PNG_SCALE: f64 = 256.0;

/// Disparity in pixels below which a pair tells nothing about depth.
const MIN_DISPARITY_PX: f64 = 0.1;

/// Baseline in metres above which it is probably given in another unit.
const MAX_BASELINE_M: f64 = 5.0;

/// A pair with its files.
struct Pair {
    left: Source,
    /// None of an image that stands alone.
    right: Option<Source>,
    /// Its ground truth, and what is in the file.
    truth: Option<(Source, Truth)>,
    focal_px: f64,
    baseline_m: f64,
    /// When the list was written or put into its place.
    list_changed: Option<SystemTime>,
}

/// Makes the set of the pairs in a list; their files are looked for from its folder.
///
/// # Errors
/// The list cannot be used, or the set not be written.
pub fn prepare(csv: &Path, shares: Shares, options: &SetOptions) -> Result<Report> {
    let wrong = |problem: String| Error::Input {
        option: "--csv",
        path: csv.to_owned(),
        problem,
    };
    let bytes = inputs::read(csv, Kind::Table).map_err(|e| wrong(e.to_string()))?;
    let table = list::parse(&bytes, shares).map_err(wrong)?;
    let wide = table
        .rows
        .iter()
        .filter(|row| row.baseline_m > MAX_BASELINE_M);
    let wide_baselines = wide.clone().next().map(|first| {
        format!(
            "{} pairs have a baseline of more than {MAX_BASELINE_M} m (first: {}, {} m); it should be metres \
             between the cameras, not millimetres",
            wide.count(),
            first.id,
            first.baseline_m
        )
    });
    let frames = frames(csv, table);
    if frames.frames.is_empty() {
        return Err(wrong(match frames.failures.first() {
            Some(first) => format!("no row can be used; the first: {}", first.problem),
            None => "it has no rows".to_owned(),
        }));
    }
    let mut report = build(Content::Pairs, options, &[], frames, make)?;
    report.doubts.extend(wide_baselines);
    Ok(report)
}

fn frames(csv: &Path, table: Table) -> Frames<Pair> {
    let mut expected = BTreeMap::new();
    let roles = table.rows.iter().map(|row| Some(row.role));
    for role in roles.chain(table.bad.iter().map(|bad| bad.role)).flatten() {
        *expected.entry(role).or_default() += 1;
    }
    let failures = table.bad.into_iter().map(|bad| Failure {
        role: bad.role,
        id: bad.id,
        file: csv.display().to_string(),
        problem: format!("{}, line {}: {}", csv.display(), bad.line, bad.problem),
    });
    let folder = csv.parent().unwrap_or(Path::new(""));
    let file = |name: &str| Source::File(folder.join(name));
    let list_changed = Source::File(csv.to_owned()).changed();
    let frame = |row: Row| Frame {
        role: row.role,
        id: row.id,
        input: Pair {
            left: file(&row.left),
            right: row.right.as_deref().map(file),
            truth: row.truth.map(|truth| (file(&truth.file), truth)),
            focal_px: row.focal_px,
            baseline_m: row.baseline_m,
            list_changed,
        },
    };
    Frames {
        frames: table.rows.into_iter().map(frame).collect(),
        failures: failures.collect(),
        expected,
    }
}

fn make(files: &SetFiles<'_>, frame: &Frame<Pair>) -> SampleResult<Sample> {
    let Frame { role, id, input } = frame;
    let keep_full = *role == Role::Test;
    let left = files.picture(Side::Left, id, &input.left, None, keep_full)?;
    let right = match &input.right {
        Some(from) => {
            let right = files.picture(Side::Right, id, from, None, false)?;
            same_size(from, right.size, left.size)?;
            Some(right.small)
        }
        None => None,
    };
    let depth = match &input.truth {
        Some((from, truth)) => Some(ground_truth(files, id, input, from, truth, left.size)?),
        None => None,
    };
    Ok(Sample {
        right,
        left_full: left.full,
        depth_camera: depth,
        ..Sample::new(id, left.size, input.focal_px, input.baseline_m, left.small)
    })
}

fn ground_truth(
    files: &SetFiles<'_>,
    id: &str,
    pair: &Pair,
    from: &Source,
    truth: &Truth,
    size: (u32, u32),
) -> SampleResult<FileRef> {
    let path = layout::depth(DepthKind::Camera, id);
    // Its metres depend on the numbers of the row as much as on the file.
    let changed = from.changed().max(pair.list_changed);
    if let Some(kept) = files.kept(&path, changed)? {
        return Ok(kept);
    }
    let extension = from.extension();
    let bytes = from
        .read(Kind::of_extension(&extension))
        .map_err(|e| SampleError::input(from, e))?;
    let Array {
        width,
        height,
        mut values,
        are_integers,
    } = decode_truth(&bytes, &extension).map_err(|problem| SampleError::about(from, problem))?;
    same_size(from, (width as u32, height as u32), size)?;
    let scale = match (truth.scale, &*extension, are_integers) {
        (Some(scale), _, _) => scale,
        (None, "png", _) => PNG_SCALE,
        (None, _, false) => 1.0,
        (None, _, true) => {
            return Err(SampleError::about(
                from,
                "its values are 16-bit integers; say in the column `depth_scale` what they are to be \
                 divided by: 256 if stored as KITTI's PNGs, 1000 for millimetres, 1 for metres or pixels",
            ));
        }
    };
    let invalid = truth.invalid.unwrap_or(0.0);
    if truth.is_disparity {
        // What was measured is told by the value in the file: 0 may be one once the offset is added.
        let depth_m = |value: f64| {
            let disparity_px = value / scale + truth.offset_px;
            match disparity_px > 0.0 && value != invalid {
                true => depth_from_disparity_px(pair.focal_px, pair.baseline_m, disparity_px),
                false => 0.0,
            }
        };
        let is_negative = |value: &&f64| {
            **value != invalid && **value / scale + truth.offset_px < 0.0 && value.is_finite()
        };
        let negative = values.iter().filter(is_negative).count();
        if negative > 0 {
            files.doubt(Doubt::NegativeDisparity, from, negative);
        }
        values.iter_mut().for_each(|value| *value = depth_m(*value));
    } else {
        let depth_m = |value: f64| if value == invalid { 0.0 } else { value / scale };
        values.iter_mut().for_each(|value| *value = depth_m(*value));
    }
    let farthest_m = depth_from_disparity_px(pair.focal_px, pair.baseline_m, MIN_DISPARITY_PX);
    let beyond =
        |depth_m: &&f64| depth_m.is_finite() && **depth_m > farthest_m && pair.right.is_some();
    let beyond = values.iter().filter(beyond).count();
    if beyond > 0 {
        files.doubt(Doubt::BeyondSight, from, beyond);
    }
    let data: Vec<f32> = values.into_iter().map(measured).collect();
    if data.iter().all(|depth_m| *depth_m == 0.0) {
        return Err(SampleError::about(from, "it has no measured pixel"));
    }
    let kind = if truth.is_disparity {
        "disparity"
    } else {
        "depth"
    };
    let header = DepthHeader {
        source: format!("pairs/{kind}"),
        axis: "camera-z".to_owned(),
        focal_px: pair.focal_px,
        baseline_m: pair.baseline_m,
        frame: id.to_owned(),
    };
    let plane = Plane {
        width,
        height,
        data,
    };
    files.put_depth(path, &plane, &header)
}

/// The values of a ground truth file of this extension, not yet scaled.
fn decode_truth(bytes: &[u8], extension: &str) -> std::result::Result<Array, String> {
    match extension {
        "png" => {
            let (width, height, values) =
                image_files::decode_gray16(bytes, "this PNG").map_err(|e| e.to_string())?;
            Ok(Array {
                width,
                height,
                values: values.into_iter().map(f64::from).collect(),
                are_integers: true,
            })
        }
        "npy" => npy::decode(bytes),
        "exr" => {
            let plane = exr::decode_channel(bytes)?;
            Ok(Array {
                width: plane.width,
                height: plane.height,
                values: plane.data.into_iter().map(f64::from).collect(),
                are_integers: false,
            })
        }
        _ => Err("ground truth is read from .png (16-bit), .npy and .exr files".to_owned()),
    }
}
