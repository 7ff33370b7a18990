//! How often the cheapest disparity is the true one, over a test set, by texture.
//!
//! For each test image with both views and ground truth, pixels spread evenly over those with truth are
//! searched along their lines. Native images where the set has them, prepared ones otherwise and where a
//! discriminator is asked, which knows no others; disparities and the three pixels that count as found are
//! those of the native width either way.
//!
//! Not here: pictures.

use std::collections::BTreeMap;

use image::RgbImage;
use rayon::prelude::*;
use strat_metrics::{
    CsvError,
    statistics::{Ratio, ratio},
};
use strat_store::{
    exr, image_files,
    progress::Progress,
    raster::Plane,
    resize::{self, Kernel},
    set::{FileRef, PreparedSet, Sample},
};

use super::{
    cost::{Cost, Line, Pair},
    discriminator::{Discriminator, DiscriminatorError},
};
use crate::evaluate::{SampleError, sample::checked_bytes};

/// An error below this many native pixels counts as found.
pub const NEAR_PX: f64 = 3.0;

/// Pixels that are searched in each image.
pub const PIXELS: usize = 2000;

/// Pixels that are searched in each image where a discriminator looks at every place of their lines.
pub const JUDGED_PIXELS: usize = 8;

/// The largest disparity that is searched, as a fraction of the width: 1.55 m before a KITTI camera.
const LARGEST: f64 = 0.2;

/// Bounds of the texture bins, in grey levels between horizontal neighbours; the last has no end.
pub const TEXTURES: [f64; 7] = [0.0, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0];

/// A pair of views with true disparities.
pub struct View {
    /// The left image.
    pub left: RgbImage,
    /// The right image.
    pub right: RgbImage,
    /// The images are the untouched ones.
    pub native: bool,
    /// Both as numbers.
    pub pair: Pair,
    /// Native pixels in a pixel of the images, along rows.
    pub scale: f64,
    /// The largest disparity that is searched, in pixels of the images.
    pub largest: usize,
    /// Pixels with all neighbours and a true disparity within the search: column, row, disparity, in pixels
    /// of the images.
    pub truths: Vec<(usize, usize, f64)>,
}

impl View {
    /// Reads a sample, in its native size, or prepared and by area brought to `size` as for training. `None`
    /// where it has no right view or no ground truth of the camera.
    ///
    /// # Errors
    /// A file cannot be used.
    pub fn open(
        set: &PreparedSet,
        sample: &Sample,
        size: Option<(u32, u32)>,
    ) -> Result<Option<Self>, SampleError> {
        let both = |left, right: &Option<FileRef>| Some((left, right.clone()?));
        let native = sample
            .left_full
            .clone()
            .and_then(|left| both(left, &sample.right_full))
            .filter(|_| size.is_none());
        let is_native = native.is_some();
        let files = native.or_else(|| both(sample.left.clone(), &sample.right));
        // The scanner's x (depth_velodyne) is not the camera's depth; it stands in where nothing else is.
        let truth = [
            &sample.depth_noc,
            &sample.depth_camera,
            &sample.depth_velodyne,
        ];
        let truth = truth.into_iter().find_map(Option::as_ref);
        let (Some((left, right)), Some(truth)) = (files, truth) else {
            return Ok(None);
        };
        let picture = |file: &FileRef| {
            let image = image_files::decode_rgb(&checked_bytes(set, file)?, &file.path)?;
            Ok::<_, SampleError>(match size {
                Some((width, height)) => resize::rgb(&image, width, height, Kernel::Area),
                None => image,
            })
        };
        let (left, right) = (picture(&left)?, picture(&right)?);
        let (depth, header) = exr::decode_depth(&checked_bytes(set, truth)?, &set.path(truth))?;
        let Some(pair) = Pair::new(&left, &right) else {
            return Err(SampleError::Missing {
                what: "right image of the left one's size",
            });
        };
        let scale = depth.width as f64 / f64::from(left.width());
        let largest = (LARGEST * f64::from(left.width())) as usize;
        let focal_baseline = header.focal_px * header.baseline_m;
        let truths = truths(&pair, &depth, focal_baseline, scale, largest);
        Ok(Some(Self {
            left,
            right,
            native: is_native,
            pair,
            scale,
            largest,
            truths,
        }))
    }

    /// The costs of a pixel of the images.
    #[must_use]
    pub fn line(&self, (x, y): (usize, usize)) -> Line {
        self.pair.line(x, y, self.largest)
    }

    /// The same, with what a discriminator says of every place.
    ///
    /// # Errors
    /// The discriminator does not run.
    pub fn judged_line(
        &self,
        at: (usize, usize),
        judge: Option<&mut Discriminator>,
    ) -> Result<Line, DiscriminatorError> {
        let mut line = self.line(at);
        if let Some(judge) = judge {
            let last = line.of(Cost::L1).len().saturating_sub(1);
            let (untouched, costs) = judge.costs(&self.pair, at, last)?;
            line.untouched = Some(untouched);
            line.costs.push(costs);
        }
        Ok(line)
    }
}

/// Pixels with a true disparity, each once: of several measurements in one prepared pixel the nearest.
fn truths(
    pair: &Pair,
    depth: &Plane,
    focal_baseline: f64,
    scale: f64,
    largest: usize,
) -> Vec<(usize, usize, f64)> {
    let (width, height) = pair.size();
    let rows = depth.height as f64 / height as f64;
    let mut found: BTreeMap<(usize, usize), f64> = BTreeMap::new();
    for row in 0..depth.height {
        for (column, depth_m) in depth.row(row).iter().enumerate() {
            let x = ((column as f64 / scale) as usize).min(width - 1);
            let y = ((row as f64 / rows) as usize).min(height - 1);
            let disparity = focal_baseline / f64::from(*depth_m) / scale;
            // The window at the true place must lie in the right image, or no search can find it.
            let reachable = (disparity.ceil() as usize) < x && disparity <= largest as f64;
            if *depth_m > 0.0 && pair.is_inside(x, y) && reachable {
                let nearest = found.entry((y, x)).or_insert(disparity);
                *nearest = nearest.max(disparity);
            }
        }
    }
    found.into_iter().map(|((y, x), d)| (x, y, d)).collect()
}

/// Hits and pixels of one image by cost and texture bin.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Counts {
    pixels: f64,
    found: [f64; 4],
    chance: f64,
}

/// What was found in one texture bin.
#[derive(Clone, Debug, PartialEq)]
pub struct Bin {
    /// Lower and upper bound of the texture, grey levels; the last bin has no upper one.
    pub texture: (f64, Option<f64>),
    /// Pixels searched.
    pub pixels: u64,
    /// Share of pixels whose cheapest disparity is within [`NEAR_PX`] of the truth, in the order of
    /// [`Cost::all`], with its interval over drives.
    pub found: Vec<Ratio>,
    /// Share that a disparity taken by chance would have.
    pub chance: f64,
}

/// What was found over a set.
#[derive(Clone, Debug, PartialEq)]
pub struct Survey {
    /// Images searched.
    pub images: u64,
    /// Of them, in native size.
    pub native: u64,
    /// Pixels searched in each image, at most.
    pub per_image: usize,
    /// The costs, in the order of each bin.
    pub costs: &'static [Cost],
    /// The bins that have pixels, then all pixels.
    pub bins: Vec<Bin>,
    /// The same over all textures.
    pub all: Option<Bin>,
    /// A sentence for each image that could not be searched.
    pub problems: Vec<String>,
}

/// Searches up to `per_image` pixels of all samples. A discriminator judges image by image.
#[must_use]
pub fn survey(
    set: &PreparedSet,
    samples: &[Sample],
    judge: Option<&mut Discriminator>,
    per_image: usize,
    pool: &rayon::ThreadPool,
    quiet: bool,
) -> Survey {
    let mut survey = Survey {
        images: 0,
        native: 0,
        per_image,
        costs: Cost::all(judge.is_some()),
        bins: Vec::new(),
        all: None,
        problems: Vec::new(),
    };
    let progress = Progress::new("matching", samples.len() as u64, "images", quiet);
    let of_image = |sample: &Sample, judge: Option<&mut Discriminator>| {
        let size = judge.as_deref().map(Discriminator::image_size);
        let view = View::open(set, sample, size);
        let found = view
            .map_err(|error| error.to_string())
            .and_then(|view| match view {
                None => Ok(None),
                Some(view) => counts(&view, per_image, judge)
                    .map(|counts| Some((view.native, counts)))
                    .map_err(|error| error.to_string()),
            });
        progress.add(1);
        found
    };
    let found: Vec<_> = match judge {
        None => pool.install(|| samples.par_iter().map(|one| of_image(one, None)).collect()),
        Some(judge) => {
            let of_image = |one: &Sample| of_image(one, Some(&mut *judge));
            samples.iter().map(of_image).collect()
        }
    };
    progress.finish();
    let mut by_image: Vec<(&str, [Counts; TEXTURES.len()])> = Vec::new();
    for (sample, found) in samples.iter().zip(found) {
        match found {
            Ok(None) => {}
            Ok(Some((native, counts))) => {
                survey.images += 1;
                survey.native += u64::from(native);
                by_image.push((&sample.id, counts));
            }
            Err(problem) => survey.problems.push(format!("{}: {problem}", sample.id)),
        }
    }
    for index in 0..TEXTURES.len() {
        let counts: Vec<(&str, Counts)> =
            by_image.iter().map(|(id, all)| (*id, all[index])).collect();
        let texture = (TEXTURES[index], TEXTURES.get(index + 1).copied());
        survey.bins.extend(bin(texture, survey.costs, &counts));
    }
    let together: Vec<(&str, Counts)> = by_image
        .iter()
        .map(|(id, all)| {
            (
                *id,
                all.iter().fold(Counts::default(), |sum, one| sum.and(one)),
            )
        })
        .collect();
    survey.all = bin((0.0, None), survey.costs, &together);
    survey
}

impl Counts {
    fn and(self, other: &Self) -> Self {
        Self {
            pixels: self.pixels + other.pixels,
            found: std::array::from_fn(|index| self.found[index] + other.found[index]),
            chance: self.chance + other.chance,
        }
    }
}

/// Searches pixels spread evenly over those with truth.
fn counts(
    view: &View,
    pixels: usize,
    mut judge: Option<&mut Discriminator>,
) -> Result<[Counts; TEXTURES.len()], DiscriminatorError> {
    let mut counts = [Counts::default(); TEXTURES.len()];
    for index in strat_store::spread::evenly(view.truths.len(), pixels) {
        let (x, y, truth) = view.truths[index];
        let line = view.judged_line((x, y), judge.as_deref_mut())?;
        let texture = view.pair.texture(x, y);
        let bin = TEXTURES.iter().rposition(|bound| texture >= *bound);
        let counts = &mut counts[bin.unwrap_or(0)];
        counts.pixels += 1.0;
        let near = NEAR_PX / view.scale;
        for cost in line.kinds() {
            counts.found[*cost as usize] += line.found(*cost, truth, near);
        }
        let candidates = line.of(Cost::L1).len();
        let close = (0..candidates).filter(|d| (*d as f64 - truth).abs() < near);
        counts.chance += close.count() as f64 / candidates.max(1) as f64;
    }
    Ok(counts)
}

fn bin(texture: (f64, Option<f64>), costs: &[Cost], by_image: &[(&str, Counts)]) -> Option<Bin> {
    let pixels: f64 = by_image.iter().map(|(_, counts)| counts.pixels).sum();
    let chance: f64 = by_image.iter().map(|(_, counts)| counts.chance).sum();
    let found = costs.iter().map(|cost| {
        let sums = by_image.iter().filter(|(_, counts)| counts.pixels > 0.0);
        ratio(sums.map(|(id, counts)| (*id, counts.found[*cost as usize], counts.pixels)))
    });
    let found = found.collect::<Option<Vec<Ratio>>>()?;
    Some(Bin {
        texture,
        pixels: pixels as u64,
        found,
        chance: chance / pixels,
    })
}

impl Survey {
    /// The table as CSV with exact numbers; the line without bounds is over all textures.
    ///
    /// # Errors
    /// The CSV writer's own; none in practice.
    pub fn csv(&self) -> Result<Vec<u8>, CsvError> {
        let mut csv = strat_csv::Writer::new(Vec::new());
        csv.write_record([
            "texture_from",
            "texture_to",
            "cost",
            "pixels",
            "drives",
            "found",
            "low",
            "high",
            "chance",
        ])?;
        let all = self.all.iter().map(|bin| (bin, true));
        for (bin, is_all) in self.bins.iter().map(|bin| (bin, false)).chain(all) {
            for (cost, ratio) in self.costs.iter().zip(&bin.found) {
                let bound = |value: Option<f64>| value.map(|v| v.to_string()).unwrap_or_default();
                csv.write_record([
                    bound((!is_all).then_some(bin.texture.0)),
                    bound(bin.texture.1),
                    cost.name().to_owned(),
                    bin.pixels.to_string(),
                    ratio.clusters.total().to_string(),
                    ratio.value.to_string(),
                    bound(ratio.interval.map(|interval| interval.low)),
                    bound(ratio.interval.map(|interval| interval.high)),
                    bin.chance.to_string(),
                ])?;
            }
        }
        Ok(csv.into_inner()?)
    }
}
