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
use strat_store::set::{Content, FileRef, Sample};
use strat_store::{files, image_files};

use crate::cli;
use crate::collections::{self as workshop, Frame, Options, Piece, Stop, Workshop};
use crate::error::{Error, Result};
use crate::input::raw;
use crate::kitti::samples::Failure;

const FOLDERS: [(&str, Role); 4] = [
    ("train", Role::Train),
    ("train_extra", Role::Train),
    ("val", Role::Val),
    ("test", Role::Test),
];

/// Arguments of `prep cityscapes`.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Example:
  prep cityscapes --root cityscapes --out sets/cityscapes")]
pub(crate) struct Args {
    /// Folder of `leftImg8bit`, `rightImg8bit`, `camera` and, if wanted, `gtFine`.
    #[arg(long, value_name = "DIR")]
    root: PathBuf,
    #[command(flatten)]
    options: Options,
}

/// Where the files of a frame are.
#[derive(Debug)]
struct Files {
    left: PathBuf,
    right: PathBuf,
    camera: PathBuf,
    labels: PathBuf,
}

/// Prepares the set and returns the exit code.
pub(crate) fn run(args: &Args) -> Result<u8> {
    let (frames, failures) = look_through(&args.root)?;
    let mut expected = BTreeMap::new();
    for frame in &frames {
        *expected.entry(frame.role).or_default() += 1;
    }
    let report = workshop::build(
        Content::Cityscapes,
        &args.options,
        &[&args.root],
        &expected,
        &frames,
        failures,
        make,
    )?;
    Ok(cli::conclude(
        &args.options.out,
        args.options.shard,
        &report,
    ))
}

/// The frames that have a left image, by role, city and name, and the folders that cannot be read.
fn look_through(root: &Path) -> Result<(Vec<Frame<Files>>, Vec<Failure>)> {
    let wrong = |problem: String| Error::Input {
        option: "--root",
        path: root.to_owned(),
        problem,
    };
    let left_root = root.join("leftImg8bit");
    if !left_root.is_dir() {
        return Err(wrong(
            "there is no folder leftImg8bit in it; give the folder into which the archives of Cityscapes \
             were unpacked"
                .to_owned(),
        ));
    }
    let mut frames = Vec::new();
    let mut failures = Vec::new();
    let mut names = |folder: &Path| {
        names(folder).unwrap_or_else(|problem| {
            failures.push(Failure {
                role: None,
                id: String::new(),
                file: folder.display().to_string(),
                problem,
            });
            Vec::new()
        })
    };
    for (folder, role) in FOLDERS {
        for city in names(&left_root.join(folder)) {
            for name in names(&left_root.join(folder).join(&city)) {
                let Some(stem) = name.strip_suffix("_leftImg8bit.png") else {
                    continue;
                };
                let place = |kind: &str, after: &str| {
                    root.join(kind)
                        .join(folder)
                        .join(&city)
                        .join(format!("{stem}_{after}"))
                };
                let id = format!("{city}/{stem}");
                workshop::check_id(&id).map_err(wrong)?;
                frames.push(Frame {
                    role,
                    id,
                    input: Files {
                        left: place("leftImg8bit", "leftImg8bit.png"),
                        right: place("rightImg8bit", "rightImg8bit.png"),
                        camera: place("camera", "camera.json"),
                        labels: place("gtFine", "gtFine_labelIds.png"),
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
            "there are no images leftImg8bit/<train|train_extra|val|test>/<city>/*_leftImg8bit.png in it"
                .to_owned(),
        ));
    }
    let mut seen = BTreeMap::new();
    for frame in &frames {
        if let Some(other) = seen.insert(&*frame.id, &frame.input.left) {
            return Err(wrong(format!(
                "the frame {} is there twice, as {} and {}; remove one",
                frame.id,
                other.display(),
                frame.input.left.display()
            )));
        }
    }
    Ok((frames, failures))
}

/// Names in a folder, sorted; none where there is no such folder.
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

fn make(workshop: &Workshop<'_>, frame: &Frame<Files>) -> Piece<Sample> {
    let Files {
        left,
        right,
        camera,
        labels,
    } = &frame.input;
    let text = files::read(camera).map_err(|e| Stop::path(camera, e))?;
    let (focal_px, baseline_m) =
        parse_camera(&text).map_err(|problem| Stop::about(camera, problem))?;
    let keep_full = frame.role == Role::Test;
    let left_picture = workshop.picture("left", &frame.id, left, Some(rows), keep_full)?;
    let right_picture = workshop.picture("right", &frame.id, right, Some(rows), false)?;
    let (size, other) = (left_picture.size, right_picture.size);
    if size != other {
        return Err(Stop::about(
            right,
            format!(
                "without its bottom fifth it is {}x{}, but its left image is {}x{}",
                other.0, other.1, size.0, size.1
            ),
        ));
    }
    let semantic = match labels.is_file() {
        true => Some(label(workshop, &frame.id, labels, size)?),
        false => None,
    };
    Ok(Sample {
        right: Some(right_picture.small),
        left_full: left_picture.full,
        semantic,
        ..Sample::new(&frame.id, size, focal_px, baseline_m, left_picture.small)
    })
}

fn label(workshop: &Workshop<'_>, id: &str, from: &Path, size: (u32, u32)) -> Piece<FileRef> {
    let path = format!("labels/semantic/{id}.png");
    if let Some(kept) = workshop.files.kept(&path, workshop::changed(from))? {
        return Ok(kept);
    }
    let (width, height, mut ids) =
        image_files::read_gray8(from).map_err(|e| Stop::path(from, e))?;
    let (width, height) = (width as u32, height as u32);
    let rows = rows((width, height)).map_err(|problem| Stop::about(from, problem))?;
    if (width, rows.end) != size {
        return Err(Stop::about(
            from,
            format!(
                "without its bottom fifth it is {width}x{}, but its image is {}x{}",
                rows.end, size.0, size.1
            ),
        ));
    }
    ids.truncate(width as usize * rows.end as usize);
    workshop
        .files
        .put(path, &image_files::encode_png_gray8(width, rows.end, &ids))
}

/// All rows but the bottom fifth: 0 to 818 of 1024.
fn rows((_, height): (u32, u32)) -> std::result::Result<Range<u32>, String> {
    match height / 5 * 4 + height % 5 * 4 / 5 {
        0 => Err(format!("it is only {height} pixels high")),
        kept => Ok(0..kept),
    }
}

/// Focal length in pixels and baseline in metres of a `camera.json`.
fn parse_camera(text: &[u8]) -> std::result::Result<(f64, f64), String> {
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
        .map_err(|e| format!("it is no camera file of Cityscapes: {e}"))?;
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
                "no camera file",
            ),
            (b"\xff", "no camera file"),
        ] {
            let problem = parse_camera(text).unwrap_err();
            assert!(problem.contains(reason), "{problem}");
        }
    }
}
