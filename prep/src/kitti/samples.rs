//! Makes the samples of KITTI's splits from the jobs of an inventory.
//!
//! What an earlier run finished is kept, unless its input was replaced since. A bad input file costs
//! its own sample only.

use std::path::Path;

use strat_geometry::{
    CamToCam, DepthAxis, NOMINAL_BASELINE_M, ScanDepth, depth_from_disparity_px, nominal_focal_px,
};
use strat_splits::Role;
use strat_store::exr::DepthHeader;
use strat_store::image_files::{self, Codec};
use strat_store::inputs::Kind;
use strat_store::layout::{self, DepthKind, LabelKind, Side};
use strat_store::raster::Plane;
use strat_store::set::{FileRef, Sample};
use strat_store::shard::Shard;

use crate::error::Result;
use crate::input::source::Source;
use crate::input::stereo2015::camera_by_size;
use crate::kitti::inventory::{Input, Inventory, Job, RawInput, ScanInput, SceneInput};
use crate::set::files::SetFiles;
use crate::set::results::Failure;
use crate::set::sample::{BadInput, SampleError, SampleResult, optional, same_size};
use crate::set::settings::Settings;
use crate::set::writer::{Report, SetOptions, write_set};

/// Least bytes per pixel of a PNG, per pixel of a JPEG of quality 92, and of a depth map that were seen
/// on frames of KITTI, so that no run is refused that would fit.
const MIN_BYTES: (f64, f64, u64) = (1.5, 0.3, 100_000);

/// Metres beyond which no scanner of a car measures; KITTI's sees 120.
const MAX_RANGE_M: f32 = 1000.0;

/// Bytes the jobs (of a shard) will write at least; of pairs whose left image is in `out` already,
/// none.
pub fn bytes_to_write(
    out: &Path,
    settings: &Settings,
    inventory: &Inventory,
    shard: Option<Shard>,
) -> u64 {
    let pixels = f64::from(settings.image_width) * f64::from(settings.image_height);
    let small = match settings.codec {
        Codec::Png => pixels * MIN_BYTES.0,
        Codec::Jpeg(quality) => pixels * MIN_BYTES.1 * f64::from(quality) / 92.0,
    };
    let depth = MIN_BYTES.2;
    let bytes = inventory.jobs.iter().map(|job| {
        let left = layout::image(
            settings.content,
            Side::Left,
            &job.id,
            settings.codec.extension(),
        );
        let is_mine = shard.is_none_or(|shard| shard.has(&job.id));
        if !is_mine || out.join(left).is_file() {
            return 0;
        }
        let (images, more) = match &job.input {
            Input::Raw(raw) => {
                let full = match job.role {
                    Role::Test => raw.left.len(),
                    Role::Train | Role::Val => 0,
                };
                let images = 1 + u64::from(raw.right.is_some());
                (images, full + 2 * depth * u64::from(raw.scan.is_some()))
            }
            Input::Scene(scene) => (2, scene.left.len() + scene.right.len() + depth),
        };
        images * small as u64 + more
    });
    bytes.sum()
}

/// Makes everything the inventory found possible and writes the set or the part of it.
///
/// # Errors
/// The output cannot be written. Bad inputs are no error here: see [`Report::failures`].
pub fn build(options: &SetOptions, settings: &Settings, inventory: &Inventory) -> Result<Report> {
    // Archives and folders that cannot be read cost many samples at once, unless all of these are
    // there elsewhere.
    let broken = match inventory.is_complete() {
        true => &[][..],
        false => &inventory.broken,
    };
    let broken = broken.iter();
    let broken = broken.map(|(path, problem)| Failure::of_many(path, problem));
    let expected = inventory.counts.iter();
    write_set(
        options,
        settings,
        expected
            .map(|(role, count)| (*role, count.expected))
            .collect(),
        &inventory.jobs,
        broken.collect(),
        |files, job, left_out| match &job.input {
            Input::Raw(input) => raw_frame(files, job, input, left_out),
            Input::Scene(input) => scene(files, job, input),
        },
    )
}

/// A frame of a drive. Without ground truth it is worthless as a test sample and still a good pair
/// elsewhere; no test needs its right image.
fn raw_frame(
    files: &SetFiles<'_>,
    job: &Job,
    input: &RawInput,
    left_out: &mut Vec<BadInput>,
) -> SampleResult<Sample> {
    let is_test = job.role == Role::Test;
    let cameras = &*input.cameras;
    let left = files.picture(Side::Left, &job.id, &input.left, None, is_test)?;
    let right = match &input.right {
        Some(from) => {
            let right = files.picture(Side::Right, &job.id, from, None, false)?;
            same_size(from, right.size, left.size)?;
            Some(right.small)
        }
        None => None,
    };
    if left.size != (cameras.width, cameras.height) {
        let ((w, h), (cw, ch)) = (left.size, (cameras.width, cameras.height));
        return Err(SampleError::input(
            &input.left,
            format!(
                "{} is {w}x{h}, but its calibration is for {cw}x{ch}",
                input.left
            ),
        ));
    }
    let scanned = input.scan.as_ref().map(|scan| {
        let depth = scan_depth(files, job, scan, cameras);
        if is_test {
            depth.map(Some)
        } else {
            optional(depth, left_out)
        }
    });
    let (depth_velodyne, depth_camera) = scanned.transpose()?.flatten().unzip();
    let annotated = input.annotated.as_ref().map(|from| {
        let depth = annotated_depth(files, job, from, cameras);
        optional(depth, left_out)
    });
    Ok(Sample {
        right,
        left_full: left.full,
        depth_velodyne,
        depth_camera,
        depth_annotated: annotated.transpose()?.flatten(),
        ..Sample::new(
            &job.id,
            left.size,
            cameras.focal_px(),
            cameras.baseline_m(),
            left.small,
        )
    })
}

/// A scene of stereo 2015.
fn scene(files: &SetFiles<'_>, job: &Job, input: &SceneInput) -> SampleResult<Sample> {
    let left = files.picture(Side::Left, &job.id, &input.left, None, true)?;
    let right = files.picture(Side::Right, &job.id, &input.right, None, true)?;
    same_size(&input.right, right.size, left.size)?;
    let size = left.size;
    let (focal_px, baseline_m) = scene_camera(input, size)?;
    let disparity = |kind, from| disparity_depth(files, job, kind, from, size, focal_px);
    let label = |kind, from: &Option<Source>| {
        let from = from.as_ref();
        from.map(|from| label(files, job, kind, from, size))
            .transpose()
    };
    Ok(Sample {
        right: Some(right.small),
        left_full: left.full,
        right_full: right.full,
        depth_noc: Some(disparity(DepthKind::Noc, &input.noc)?),
        depth_occ: input
            .occ
            .as_ref()
            .map(|occ| disparity(DepthKind::Occ, occ))
            .transpose()?,
        semantic: label(LabelKind::Semantic, &input.semantic)?,
        instance: label(LabelKind::Instance, &input.instance)?,
        ..Sample::new(&job.id, size, focal_px, baseline_m, left.small)
    })
}

/// Focal length in pixels and baseline in metres of a scene.
fn scene_camera(input: &SceneInput, (width, height): (u32, u32)) -> SampleResult<(f64, f64)> {
    let Some(path) = &input.calibration else {
        return camera_by_size(width, height).ok_or_else(|| {
            let left = &input.left;
            SampleError::input(
                left,
                format!(
                    "{left} is {width}x{height}, which is not a KITTI size, and has no calibration"
                ),
            )
        });
    };
    let bytes = path
        .read(Kind::Calibration)
        .map_err(|e| SampleError::input(path, e))?;
    let cameras = CamToCam::parse(&String::from_utf8_lossy(&bytes))
        .map_err(|e| SampleError::about(path, e))?;
    if (cameras.width, cameras.height) != (width, height) {
        let problem = format!(
            "{path} is for {}x{}, but the image is {width}x{height}",
            cameras.width, cameras.height
        );
        return Err(SampleError::input(path, problem));
    }
    Ok((cameras.focal_px(), cameras.baseline_m()))
}

/// Ground truth of a scan: along the scanner's axis and along the camera's.
fn scan_depth(
    files: &SetFiles<'_>,
    job: &Job,
    input: &ScanInput,
    cameras: &CamToCam,
) -> SampleResult<(FileRef, FileRef)> {
    let scan = &input.file;
    let [velodyne, camera] =
        [DepthKind::Velodyne, DepthKind::Camera].map(|kind| layout::depth(kind, &job.id));
    // It depends on the calibration as much as on the scan.
    let changed = scan.changed().max(input.calibration_changed);
    let kept = (
        files.kept(&velodyne, changed)?,
        files.kept(&camera, changed)?,
    );
    if let (Some(velodyne), Some(camera)) = kept {
        return Ok((velodyne, camera));
    }
    let (width, height) = (cameras.width as usize, cameras.height as usize);
    let axes = [DepthAxis::VelodyneX, DepthAxis::CameraZ];
    let mut depth = ScanDepth::new(&input.projection, width, height, axes);
    scan.read_in_pieces(|bytes| depth.add(bytes))
        .map_err(|e| SampleError::input(scan, e))?;
    let depth = depth.finish().map_err(|e| SampleError::about(scan, e))?;
    let [along_scanner, along_camera] = depth.map(|data| Plane {
        width,
        height,
        data,
    });
    let farthest_m = along_scanner.data.iter().copied().fold(0.0, f32::max);
    if farthest_m == 0.0 {
        let problem = "no point of the scan falls into the image";
        return Err(SampleError::about(scan, problem));
    }
    if farthest_m > MAX_RANGE_M {
        let problem = format!(
            "a point lies {farthest_m} m away, but no such scanner sees beyond {MAX_RANGE_M} m; coordinates \
             should be metres in 32-bit floats"
        );
        return Err(SampleError::about(scan, problem));
    }
    let header = |axis| depth_header("velodyne", axis, job, cameras);
    Ok((
        files.put_depth(velodyne, &along_scanner, &header("velodyne-x"))?,
        files.put_depth(camera, &along_camera, &header("camera-z"))?,
    ))
}

/// Annotated depth of KITTI depth: 16-bit metres times 256, 0 where nothing is known.
fn annotated_depth(
    files: &SetFiles<'_>,
    job: &Job,
    from: &Source,
    cameras: &CamToCam,
) -> SampleResult<FileRef> {
    let path = layout::depth(DepthKind::Annotated, &job.id);
    if let Some(kept) = files.kept(&path, from.changed())? {
        return Ok(kept);
    }
    let depth_m = gray16(from, (cameras.width, cameras.height), |value| {
        f32::from(value) / 256.0
    })?;
    let header = depth_header("kitti-depth/groundtruth", "camera-z", job, cameras);
    files.put_depth(path, &depth_m, &header)
}

fn depth_header(source: &str, axis: &str, job: &Job, cameras: &CamToCam) -> DepthHeader {
    DepthHeader {
        source: source.to_owned(),
        axis: axis.to_owned(),
        focal_px: cameras.focal_px(),
        baseline_m: cameras.baseline_m(),
        frame: job.id.clone(),
    }
}

/// Ground truth of a stereo 2015 disparity map, in metres of the nominal rig (PROTOCOL 3.4).
fn disparity_depth(
    files: &SetFiles<'_>,
    job: &Job,
    kind: DepthKind,
    from: &Source,
    size: (u32, u32),
    focal_px: f64,
) -> SampleResult<FileRef> {
    let path = layout::depth(kind, &job.id);
    if let Some(kept) = files.kept(&path, from.changed())? {
        return Ok(kept);
    }
    let focal_px = nominal_focal_px(size.0).unwrap_or(focal_px);
    // Disparity is stored times 256; 0 means no measurement.
    let depth_m = gray16(from, size, |value| match value {
        0 => 0.0,
        value => {
            let disparity_px = f64::from(value) / 256.0;
            depth_from_disparity_px(focal_px, NOMINAL_BASELINE_M, disparity_px) as f32
        }
    })?;
    let header = DepthHeader {
        source: format!("kitti2015/disp_{}_0", kind.as_str()),
        axis: "camera-z".to_owned(),
        focal_px,
        baseline_m: NOMINAL_BASELINE_M,
        frame: job.id.clone(),
    };
    files.put_depth(path, &depth_m, &header)
}

/// Metres of a 16-bit map of the size of its image with at least one measurement.
fn gray16(from: &Source, size: (u32, u32), depth_m: impl Fn(u16) -> f32) -> SampleResult<Plane> {
    let bytes = from
        .read(Kind::Image)
        .map_err(|e| SampleError::input(from, e))?;
    let (width, height, raw) = image_files::decode_gray16(&bytes, &from.to_string())
        .map_err(|e| SampleError::input(from, e))?;
    same_size(from, (width as u32, height as u32), size)?;
    if raw.iter().all(|value| *value == 0) {
        let problem = format!("{from} has no measured pixel");
        return Err(SampleError::input(from, problem));
    }
    Ok(Plane {
        width,
        height,
        data: raw.into_iter().map(depth_m).collect(),
    })
}

/// A label image, copied as it is after a look at it.
fn label(
    files: &SetFiles<'_>,
    job: &Job,
    kind: LabelKind,
    from: &Source,
    size: (u32, u32),
) -> SampleResult<FileRef> {
    let path = layout::label(kind, &job.id);
    if let Some(kept) = files.kept(&path, from.changed())? {
        return Ok(kept);
    }
    let bytes = from
        .read(Kind::Image)
        .map_err(|e| SampleError::input(from, e))?;
    let name = from.to_string();
    let found = match kind {
        LabelKind::Semantic => image_files::decode_gray8(&bytes, &name).map(|(w, h, _)| (w, h)),
        LabelKind::Instance => image_files::decode_gray16(&bytes, &name).map(|(w, h, _)| (w, h)),
    };
    let (width, height) = found.map_err(|e| SampleError::input(from, e))?;
    same_size(from, (width as u32, height as u32), size)?;
    files.put(path, &bytes)
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use strat_store::files::write_atomic;
    use strat_store::resize::Kernel;
    use strat_store::set::Content;

    use super::*;
    use crate::set::settings::ImageOptions;

    #[test]
    fn the_bytes_to_write_are_those_that_are_missing() {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path();
        let cameras = CamToCam {
            width: 1242,
            height: 375,
            r_rect_00: [[0.0; 3]; 3],
            p_rect_02: [[0.0; 4]; 3],
            p_rect_03: [[0.0; 4]; 3],
        };
        let cameras = Arc::new(cameras);
        let drive = strat_splits::drives()[0].id;
        let job = |index| {
            let frame = strat_splits::FrameId { drive, index };
            let source = Source::File(out.join("no file"));
            Job {
                role: Role::Train,
                id: frame.to_string(),
                input: Input::Raw(RawInput {
                    left: source.clone(),
                    right: Some(source),
                    cameras: Arc::clone(&cameras),
                    scan: None,
                    annotated: None,
                }),
            }
        };
        let mut inventory = Inventory::default();
        inventory.jobs.extend((0..1000).map(job));
        let mut settings = Settings::new(
            Content::Kitti,
            false,
            ImageOptions {
                width: 512,
                height: 256,
                kernel: Kernel::Area,
                codec: Codec::Png,
            },
        );
        let png = bytes_to_write(out, &settings, &inventory, None);
        assert_eq!(png, 1000 * 2 * 196_608, "1.5 bytes a pixel");
        let first = layout::image(Content::Kitti, Side::Left, &inventory.jobs[0].id, "png");
        write_atomic(&out.join(first), b"").unwrap();
        let rest = bytes_to_write(out, &settings, &inventory, None);
        assert_eq!(rest, 999 * 2 * 196_608, "what is there needs no room");
        let shards = (0..3).map(|index| Shard { index, count: 3 });
        let parts = shards.map(|shard| bytes_to_write(out, &settings, &inventory, Some(shard)));
        assert_eq!(parts.sum::<u64>(), rest);
        settings.codec = Codec::Jpeg(92);
        let jpeg = bytes_to_write(out, &settings, &inventory, None);
        assert!(jpeg < png / 4, "{jpeg}");
    }
}
