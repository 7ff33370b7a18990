//! Cityscapes as a prepared set (PROTOCOL 1.5).
//!
//! Roles come from the folder names: `train` and `train_extra` train, `val` validates, `test`
//! tests. The bottom fifth, the bonnet of the car, is cut off every image and label map. Focal
//! length and baseline come from each frame's `camera.json`. Depth is not made: Cityscapes has
//! no measured one.

use std::collections::BTreeMap;
use std::ops::Range;
use std::path::{Path, PathBuf};

use serde::Deserialize;
use strat_splits::Role;
use strat_store::image_files;
use strat_store::inputs::Kind;
use strat_store::layout::{self, LabelKind, Side};
use strat_store::set::{Content, FileRef, Sample, check_id};

use super::{Frames, build};
use crate::error::{Error, Result};
use crate::input::raw;
use crate::input::source::Source;
use crate::set::files::SetFiles;
use crate::set::results::Failure;
use crate::set::sample::{Frame, SampleError, SampleResult};
use crate::set::writer::{Report, SetOptions};

const FOLDERS: [(&str, Role); 4] = [
    ("train", Role::Train),
    ("train_extra", Role::Train),
    ("val", Role::Val),
    ("test", Role::Test),
];

/// Where the files of a frame are.
#[derive(Debug)]
struct Files {
    left: Source,
    right: Source,
    camera: Source,
    labels: PathBuf,
}

/// Makes the set of a folder that holds `leftImg8bit`, `rightImg8bit`, `camera` and, if wanted, `gtFine`.
///
/// # Errors
/// The folder holds no images, or the set cannot be written.
pub fn prepare(root: &Path, options: &SetOptions) -> Result<Report> {
    let frames = look_through(root)?;
    build(Content::Cityscapes, options, &[root], frames, make)
}

/// The frames that have a left image, by role, city and name, and the folders that cannot be read.
fn look_through(root: &Path) -> Result<Frames<Files>> {
    let wrong = |problem: String| Error::Input {
        option: "--root",
        path: root.to_owned(),
        problem,
    };
    let left_root = root.join("leftImg8bit");
    if !left_root.is_dir() {
        return Err(wrong(
            "it has no folder leftImg8bit; give the folder into which the archives of Cityscapes \
             were unpacked"
                .to_owned(),
        ));
    }
    let mut frames = Vec::new();
    let mut failures = Vec::new();
    let mut names = |folder: &Path| {
        names(folder).unwrap_or_else(|problem| {
            failures.push(Failure::of_many(folder, problem));
            Vec::new()
        })
    };
    for (folder, role) in FOLDERS {
        for city in names(&left_root.join(folder)) {
            for name in names(&left_root.join(folder).join(&city)) {
                let Some(stem) = name.strip_suffix("_leftImg8bit.png") else {
                    continue;
                };
                let path = |kind: &str, after: &str| {
                    root.join(kind)
                        .join(folder)
                        .join(&city)
                        .join(format!("{stem}_{after}"))
                };
                let id = format!("{city}/{stem}");
                check_id(&id).map_err(wrong)?;
                frames.push(Frame {
                    role,
                    id,
                    input: Files {
                        left: Source::File(path("leftImg8bit", "leftImg8bit.png")),
                        right: Source::File(path("rightImg8bit", "rightImg8bit.png")),
                        camera: Source::File(path("camera", "camera.json")),
                        labels: path("gtFine", "gtFine_labelIds.png"),
                    },
                });
            }
        }
    }
    if frames.is_empty() {
        if let Some(failure) = failures.first() {
            return Err(wrong(failure.problem.clone()));
        }
        return Err(wrong(
            "no images leftImg8bit/<train|train_extra|val|test>/<city>/*_leftImg8bit.png in it"
                .to_owned(),
        ));
    }
    let mut seen = BTreeMap::new();
    let mut expected = BTreeMap::new();
    for frame in &frames {
        *expected.entry(frame.role).or_default() += 1;
        if let Some(other) = seen.insert(&*frame.id, &frame.input.left) {
            return Err(wrong(format!(
                "the frame {} occurs twice, as {} and {}; remove one",
                frame.id, other, frame.input.left
            )));
        }
    }
    Ok(Frames {
        frames,
        failures,
        expected,
    })
}

/// Names in a folder, sorted; none where the folder does not exist.
fn names(folder: &Path) -> std::result::Result<Vec<String>, String> {
    match std::fs::metadata(folder) {
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(Vec::new()),
        Ok(metadata) if !metadata.is_dir() => return Ok(Vec::new()),
        _ => {}
    }
    let mut names = raw::names(folder).map_err(|e| e.to_string())?;
    names.retain(|name| !name.starts_with('.'));
    Ok(names)
}

fn make(files: &SetFiles<'_>, frame: &Frame<Files>) -> SampleResult<Sample> {
    let Files {
        left,
        right,
        camera,
        labels,
    } = &frame.input;
    let text = camera
        .read(Kind::Calibration)
        .map_err(|e| SampleError::input(camera, e))?;
    let (focal_px, baseline_m) =
        parse_camera(&text).map_err(|problem| SampleError::about(camera, problem))?;
    let keep_full = frame.role == Role::Test;
    let left = files.picture(Side::Left, &frame.id, left, Some(rows), keep_full)?;
    let right_picture = files.picture(Side::Right, &frame.id, right, Some(rows), false)?;
    check_cropped(right, right_picture.size, left.size)?;
    let semantic = match labels.is_file() {
        true => Some(label(files, &frame.id, labels, left.size)?),
        false => None,
    };
    Ok(Sample {
        right: Some(right_picture.small),
        left_full: left.full,
        semantic,
        ..Sample::new(&frame.id, left.size, focal_px, baseline_m, left.small)
    })
}

fn label(files: &SetFiles<'_>, id: &str, path: &Path, size: (u32, u32)) -> SampleResult<FileRef> {
    let from = &Source::File(path.to_owned());
    let to = layout::label(LabelKind::Semantic, id);
    if let Some(kept) = files.kept(&to, from.changed())? {
        return Ok(kept);
    }
    let (width, height, mut ids) =
        image_files::read_gray8(path).map_err(|e| SampleError::input(from, e))?;
    let (width, height) = (width as u32, height as u32);
    let rows = rows((width, height)).map_err(|problem| SampleError::about(from, problem))?;
    check_cropped(from, (width, rows.end), size)?;
    ids.truncate(width as usize * rows.end as usize);
    files.put(to, &image_files::encode_png_gray8(width, rows.end, &ids))
}

/// Makes sure that what was cropped has the size of its cropped left image.
fn check_cropped(file: &Source, found: (u32, u32), left: (u32, u32)) -> SampleResult<()> {
    if found == left {
        return Ok(());
    }
    let ((w, h), (lw, lh)) = (found, left);
    let problem =
        format!("without its bottom fifth it is {w}x{h}, but its left image is {lw}x{lh}");
    Err(SampleError::about(file, problem))
}

/// All rows but the bottom fifth: 0 to 818 of 1024.
fn rows((_, height): (u32, u32)) -> std::result::Result<Range<u32>, String> {
    match height / 5 * 4 + height % 5 * 4 / 5 {
        0 => Err(format!("it is only {height} pixels high")),
        kept => Ok(0..kept),
    }
}

/// Focal length in pixels and baseline in metres, both above 0, of a `camera.json`.
///
/// # Errors
/// It is not JSON, or lacks one of the two; with a sentence.
pub fn parse_camera(text: &[u8]) -> std::result::Result<(f64, f64), String> {
    #[derive(Deserialize)]
    struct Camera {
        intrinsic: Intrinsic,
        extrinsic: Extrinsic,
    }
    #[derive(Deserialize)]
    struct Intrinsic {
        fx: f64,
    }
    #[derive(Deserialize)]
    struct Extrinsic {
        baseline: f64,
    }
    let camera: Camera = serde_json::from_slice(text)
        .map_err(|e| format!("it is not a camera file of Cityscapes: {e}"))?;
    let (fx, baseline) = (camera.intrinsic.fx, camera.extrinsic.baseline);
    for (key, number) in [("intrinsic.fx", fx), ("extrinsic.baseline", baseline)] {
        if !(number.is_finite() && number > 0.0) {
            return Err(format!("`{key}` should be positive, but is {number}"));
        }
    }
    Ok((fx, baseline))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_bottom_fifth_goes() {
        assert_eq!(rows((2048, 1024)), Ok(0..819));
        assert_eq!(rows((8, 20)), Ok(0..16));
        assert_eq!(rows((8, u32::MAX)), Ok(0..3_435_973_836));
        assert!(rows((8, 1)).is_err());
    }

    #[test]
    fn cameras_are_read_or_refused() {
        let text = br#"{"extrinsic": {"baseline": 0.209313, "pitch": 0.03},
            "intrinsic": {"fx": 2262.52, "fy": 2265.3, "u0": 1096.98, "v0": 513.137}}"#;
        assert_eq!(parse_camera(text), Ok((2262.52, 0.209313)));
        for (text, reason) in [
            (
                &br#"{"extrinsic": {}, "intrinsic": {"fx": 2262.5}}"#[..],
                "missing field `baseline`",
            ),
            (
                br#"{"extrinsic": {"baseline": -1}, "intrinsic": {"fx": 2262.5}}"#,
                "positive",
            ),
            (
                br#"{"extrinsic": {"baseline": "x"}, "intrinsic": {"fx": 1}}"#,
                "not a camera file",
            ),
            (b"\xff", "not a camera file"),
        ] {
            let problem = parse_camera(text).unwrap_err();
            assert!(problem.contains(reason), "{problem}");
        }
    }
}
