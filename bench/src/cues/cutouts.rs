//! Sprites cut from a labelled set's own images (`bench sprites`).
//!
//! Cars and pedestrians are taken whole from the instance map (PROTOCOL 1.3: label * 256 +
//! number): large ones that touch no border, upright as their kind is, with ground truth that
//! gives their real height by height_px * depth / f. Cars are those seen from behind or in front
//! (about as wide as high), as in the thesis. The largest come first; a crate, which no street
//! has, is added from the embedded sprites. The cut-outs stay under the licence of their source.

use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
};

use image::{ImageFormat, Rgba, RgbaImage};
use strat_splits::Role;
use strat_store::{
    claim::Mark,
    exr, files, image_files,
    progress::Progress,
    set::{PreparedSet, Sample},
    yaml,
};

use super::{
    error::CueError,
    sprites::{self, DESCRIPTION, SpriteEntry, SpriteFile, View},
};
use crate::evaluate::{self, SampleError};

/// Pixels kept around an object.
const MARGIN: usize = 4;
/// Shorter objects would have to be enlarged too much.
const LEAST_HEIGHT_PX: usize = 48;
/// Least share of the bounding box that an object fills; less is an object behind another.
const LEAST_FILL: f64 = 0.4;
/// Least number of measured pixels for a depth.
const LEAST_MEASURED: usize = 20;

/// Whose a folder of sprites is.
pub const MARK: Mark = Mark {
    command: "bench sprites",
    record: DESCRIPTION,
    begins: "# Cut by `bench sprites`.\n",
    writes: |name| name == DESCRIPTION || name.ends_with(".png"),
};

/// What is looked for: name, label, range of width over height, range of real heights in metres.
struct Kind {
    name: &'static str,
    label: u16,
    aspect: [f64; 2],
    height_m: [f64; 2],
}

const KINDS: [Kind; 2] = [
    Kind {
        name: "car",
        label: 26,
        aspect: [0.85, 1.6],
        height_m: [1.2, 2.3],
    },
    Kind {
        name: "pedestrian",
        label: 24,
        aspect: [0.2, 0.75],
        height_m: [1.2, 2.2],
    },
];

/// What was cut.
#[derive(Debug, Default)]
pub struct Cut {
    /// Entries with their pictures.
    pub sprites: Vec<(SpriteEntry, Vec<u8>)>,
    /// Images that could not be read, a sentence each.
    pub failures: Vec<String>,
}

struct Candidate {
    kind: usize,
    height_px: usize,
    entry: SpriteEntry,
    png: Vec<u8>,
}

/// Cuts `each` sprites of each kind.
///
/// # Errors
/// The set has no instance maps, or nothing in it can be cut.
pub fn cut(set: &PreparedSet, each: usize, quiet: bool) -> Result<Cut, CueError> {
    let samples: Vec<Sample> = set
        .samples(Role::Test)?
        .into_iter()
        .filter(|sample| sample.instance.is_some() && sample.left_full.is_some())
        .collect();
    let nothing = |reason: String| CueError::Sprites {
        what: format!("sprites from {}", set.root.display()),
        reason,
    };
    if samples.is_empty() {
        return Err(nothing(
            "its test images have no instance maps; prepare the KITTI semantics labels with it"
                .to_owned(),
        ));
    }
    let progress = Progress::new("sprites", samples.len() as u64, "images", quiet);
    let mut found: Vec<Candidate> = Vec::new();
    let mut result = Cut::default();
    for sample in &samples {
        match candidates(set, sample) {
            Ok(more) => found.extend(more),
            Err(error) => result
                .failures
                .push(format!("image {}: {error}", sample.id)),
        }
        progress.add(1);
    }
    progress.finish();
    found.sort_by(|a, b| {
        (a.kind, b.height_px)
            .cmp(&(b.kind, a.height_px))
            .then_with(|| a.entry.file.cmp(&b.entry.file))
    });
    let mut taken = BTreeMap::new();
    for candidate in found {
        let count: &mut usize = taken.entry(candidate.kind).or_default();
        if *count < each {
            *count += 1;
            let mut entry = candidate.entry;
            // `bench cues` takes one sprite of each name.
            if *count > 1 {
                entry.name = format!("{} {count}", entry.name);
            }
            result.sprites.push((entry, candidate.png));
        }
    }
    if result.sprites.is_empty() {
        return Err(nothing(format!(
            "no whole car or pedestrian of at least {LEAST_HEIGHT_PX} pixels with ground truth was found"
        )));
    }
    if let Some(sprite) = sprites::embedded()?
        .into_iter()
        .find(|sprite| !sprite.familiar)
    {
        let entry = SpriteEntry {
            file: "crate.png".to_owned(),
            name: sprite.name.clone(),
            view: None,
            familiar: false,
            height_m: sprite.height_m,
            anchor: None,
        };
        result.sprites.push((entry, encode(&sprite.image)?));
    }
    Ok(result)
}

/// Writes pictures and, last, their description.
///
/// # Errors
/// A file cannot be written.
pub fn write(folder: &Path, cut: &Cut) -> Result<Vec<PathBuf>, CueError> {
    let mut paths = Vec::new();
    for (entry, png) in &cut.sprites {
        let path = folder.join(&entry.file);
        files::write_atomic(&path, png)?;
        paths.push(path);
    }
    let description = SpriteFile {
        sprites: cut.sprites.iter().map(|(entry, _)| entry.clone()).collect(),
    };
    let text = format!("{}{}", MARK.begins, yaml::to_string(&description)?);
    MARK.finish(folder, text.as_bytes())?;
    paths.push(folder.join(DESCRIPTION));
    Ok(paths)
}

fn encode(image: &RgbaImage) -> Result<Vec<u8>, CueError> {
    let mut bytes = std::io::Cursor::new(Vec::new());
    image
        .write_to(&mut bytes, ImageFormat::Png)
        .map_err(|error| CueError::Sprites {
            what: "a sprite".to_owned(),
            reason: error.to_string(),
        })?;
    Ok(bytes.into_inner())
}

/// Left, top, right, bottom (exclusive) and number of pixels of each instance.
fn boxes(instances: &[u16], width: usize) -> BTreeMap<u16, ([usize; 4], usize)> {
    let mut boxes: BTreeMap<u16, ([usize; 4], usize)> = BTreeMap::new();
    for (index, &id) in instances.iter().enumerate() {
        // The number 0 stands for no single object.
        if id % 256 == 0 {
            continue;
        }
        let (x, y) = (index % width, index / width);
        let (area, count) = boxes.entry(id).or_insert(([x, y, x + 1, y + 1], 0));
        *area = [
            area[0].min(x),
            area[1].min(y),
            area[2].max(x + 1),
            area[3].max(y + 1),
        ];
        *count += 1;
    }
    boxes
}

fn candidates(set: &PreparedSet, sample: &Sample) -> Result<Vec<Candidate>, CueError> {
    let failed = |source: SampleError| CueError::Background {
        id: sample.id.clone(),
        source,
    };
    let Some(file) = &sample.instance else {
        return Ok(Vec::new());
    };
    let truth = [&sample.depth_noc, &sample.depth_occ, &sample.depth_camera]
        .into_iter()
        .flatten()
        .next();
    let Some(truth) = truth.filter(|_| sample.focal_px > 0.0) else {
        return Ok(Vec::new());
    };
    let bytes = |file| evaluate::sample::checked_bytes(set, file).map_err(failed);
    let (width, height, instances) = image_files::decode_gray16(&bytes(file)?, &file.path)?;
    let (depth, _) = exr::decode_depth(&bytes(truth)?, &set.path(truth))?;
    let picture = evaluate::sample::load_image(set, sample).map_err(failed)?;
    let size = (sample.width as usize, sample.height as usize);
    if (width, height) != size || (depth.width, depth.height) != size {
        return Err(failed(SampleError::Size {
            path: file.path.clone(),
            found_width: width,
            found_height: height,
            width: sample.width,
            height: sample.height,
        }));
    }
    let mut found = Vec::new();
    for (id, ([left, top, right, bottom], pixels)) in boxes(&instances, width) {
        let Some((number, kind)) = KINDS
            .iter()
            .enumerate()
            .find(|(_, kind)| kind.label == id / 256)
        else {
            continue;
        };
        let (w, h) = (right - left, bottom - top);
        let whole =
            left > MARGIN && top > MARGIN && right + MARGIN < width && bottom + MARGIN < height;
        let within = |value: f64, [low, high]: [f64; 2]| (low..=high).contains(&value);
        let fill = pixels as f64 / (w * h) as f64;
        if !whole
            || h < LEAST_HEIGHT_PX
            || fill < LEAST_FILL
            || !within(w as f64 / h as f64, kind.aspect)
        {
            continue;
        }
        let mut measured: Vec<f64> = (top..bottom)
            .flat_map(|y| (left..right).map(move |x| y * width + x))
            .filter(|&index| instances[index] == id && depth.data[index] > 0.0)
            .map(|index| f64::from(depth.data[index]))
            .collect();
        if measured.len() < LEAST_MEASURED {
            continue;
        }
        let Some(depth_m) = strat_metrics::median(&mut measured) else {
            continue;
        };
        let height_m = h as f64 * depth_m / sample.focal_px;
        if !within(height_m, kind.height_m) {
            continue;
        }
        let belongs = |x: i64, y: i64| {
            let inside = x >= 0 && y >= 0 && (x as usize) < width && (y as usize) < height;
            inside && instances[y as usize * width + x as usize] == id
        };
        let size = ((w + 2 * MARGIN) as u32, (h + 2 * MARGIN) as u32);
        let image = RgbaImage::from_fn(size.0, size.1, |column, row| {
            let (x, y) = (
                (left + column as usize) as i64 - MARGIN as i64,
                (top + row as usize) as i64 - MARGIN as i64,
            );
            // A soft edge: the share of the nine pixels around that belong to the object.
            let around = (-1..=1)
                .flat_map(|dy| (-1..=1).map(move |dx| (dx, dy)))
                .filter(|(dx, dy)| belongs(x + dx, y + dy))
                .count();
            let colour = picture.get_pixel(x.max(0) as u32, y.max(0) as u32).0;
            let alpha = if belongs(x, y) { around * 255 / 9 } else { 0 };
            Rgba([colour[0], colour[1], colour[2], alpha as u8])
        });
        let place = sample.id.replace(['/', '\\'], "_");
        found.push(Candidate {
            kind: number,
            height_px: h,
            entry: SpriteEntry {
                file: format!("{}_{place}_{}.png", kind.name, id % 256),
                name: kind.name.to_owned(),
                view: Some(View::Rear),
                familiar: true,
                height_m: (1000.0 * height_m).round() / 1000.0,
                anchor: None,
            },
            png: encode(&image)?,
        });
    }
    Ok(found)
}
