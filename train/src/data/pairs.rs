//! Stereo pairs of a prepared set, read on demand.

use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;
use std::sync::{Arc, Mutex, OnceLock, PoisonError};

use image::RgbImage;
use strat_onnx::metadata::{Spread, TrainingCamera};
use strat_splits::Role;
use strat_store::image_files::read_rgb;
use strat_store::resize::{self, Kernel};
use strat_store::set::PreparedSet;

use crate::error::{Error, Result};

/// A rectified stereo pair at the network's input size.
#[derive(Clone, Debug)]
pub struct Pair {
    /// Left view.
    pub left: RgbImage,
    /// Right view, same size.
    pub right: RgbImage,
}

impl Pair {
    /// Brings both views to the network's input size: by area when that is smaller, as the
    /// prepared images themselves were made (PROTOCOL 4.6).
    #[must_use]
    pub fn resized(self, width: u32, height: u32) -> Self {
        let fit = |view: RgbImage| {
            if view.dimensions() == (width, height) {
                view
            } else {
                resize::rgb(&view, width, height, Kernel::Area)
            }
        };
        Self {
            left: fit(self.left),
            right: fit(self.right),
        }
    }
}

/// Where a pair is.
struct Entry {
    id: String,
    drive: String,
    left: PathBuf,
    right: PathBuf,
    /// Focal length as a fraction of the width and baseline in metres; 0 where not known.
    camera: [f64; 2],
}

struct Inner {
    width: u32,
    height: u32,
    entries: Vec<Entry>,
    /// Decoded pairs, when the whole set is small enough to be kept.
    cache: Option<Vec<OnceLock<Arc<Pair>>>>,
    /// Pairs that could not be read, with the reason.
    broken: Mutex<BTreeMap<usize, String>>,
}

/// The pairs of one role, read on demand.
#[derive(Clone)]
pub struct Pairs(Arc<Inner>);

impl Pairs {
    /// The pairs of `role` in a prepared set, to be delivered at `width` x `height`.
    ///
    /// They are kept in memory once decoded if all of them fit into `cache_mib` MiB.
    ///
    /// # Errors
    /// When the role's table cannot be read or has no line.
    pub fn from_set(
        set: &PreparedSet,
        role: Role,
        width: u32,
        height: u32,
        cache_mib: u64,
    ) -> Result<Self> {
        let entries: Vec<Entry> = set
            .samples(role)?
            .into_iter()
            .filter_map(|sample| {
                // A single image has nothing to be compared with.
                let right = set.path(sample.right.as_ref()?);
                Some(Entry {
                    left: set.path(&sample.left),
                    right,
                    camera: [sample.focal_px / f64::from(sample.width), sample.baseline_m],
                    drive: sample.drive().to_owned(),
                    id: sample.id,
                })
            })
            .collect();
        if entries.is_empty() {
            return Err(Error::EmptySet {
                root: set.root.clone(),
                role: role.to_string(),
            });
        }
        let bytes = entries.len() as u64 * u64::from(width) * u64::from(height) * 6;
        let cached = bytes <= cache_mib.saturating_mul(1 << 20);
        Ok(Self::new(entries, width, height, cached))
    }

    fn new(entries: Vec<Entry>, width: u32, height: u32, cached: bool) -> Self {
        let cache = cached.then(|| entries.iter().map(|_| OnceLock::new()).collect());
        Self(Arc::new(Inner {
            width,
            height,
            entries,
            cache,
            broken: Mutex::new(BTreeMap::new()),
        }))
    }

    /// Number of pairs.
    #[must_use]
    pub fn count(&self) -> usize {
        self.0.entries.len()
    }

    /// Values of one view as the network takes it.
    pub(super) fn values(&self) -> usize {
        3 * self.0.width as usize * self.0.height as usize
    }

    /// Drives that the pairs come from, sorted.
    #[must_use]
    pub fn drives(&self) -> Vec<String> {
        let drives: BTreeSet<&str> = self
            .0
            .entries
            .iter()
            .map(|entry| entry.drive.as_str())
            .collect();
        drives.into_iter().map(str::to_owned).collect()
    }

    /// The cameras of the pairs, each pair counting once; none where one pair's is not known.
    #[must_use]
    pub fn camera(&self) -> Option<TrainingCamera> {
        let spread = |index: usize| Spread::of(self.0.entries.iter().map(|e| e.camera[index]));
        Some(TrainingCamera {
            focal_fraction: spread(0)?,
            baseline_m: spread(1)?,
        })
    }

    /// Pairs found unreadable so far.
    #[must_use]
    pub fn broken(&self) -> usize {
        self.0
            .broken
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .len()
    }

    /// The pair at an index, decoded and at network size.
    ///
    /// # Errors
    /// With a sentence that names the file, when it cannot be read or the views differ in size.
    fn load(&self, index: usize) -> std::result::Result<Arc<Pair>, String> {
        let cell = self.0.cache.as_ref().map(|cache| &cache[index]);
        if let Some(pair) = cell.and_then(OnceLock::get) {
            return Ok(Arc::clone(pair));
        }
        let entry = &self.0.entries[index];
        let pair = Pair {
            left: read_rgb(&entry.left).map_err(|error| error.to_string())?,
            right: read_rgb(&entry.right).map_err(|error| error.to_string())?,
        };
        if pair.left.dimensions() != pair.right.dimensions() {
            let (lw, lh) = pair.left.dimensions();
            let (rw, rh) = pair.right.dimensions();
            return Err(format!(
                "the views of pair {} differ in size: left {lw}x{lh}, right {rw}x{rh}",
                entry.id
            ));
        }
        let pair = Arc::new(pair.resized(self.0.width, self.0.height));
        if let Some(cell) = cell {
            // Another worker may have been first; both decoded the same bytes.
            let _ = cell.set(Arc::clone(&pair));
        }
        Ok(pair)
    }

    /// The pair at `order[position]`, or the next readable one after it, with its index.
    ///
    /// # Errors
    /// When more than one in a hundred pairs (and more than one) are unreadable.
    pub(super) fn load_or_next(
        &self,
        order: &[usize],
        position: usize,
        warnings: &Mutex<Vec<String>>,
    ) -> Result<(usize, Arc<Pair>)> {
        let allowed = self.count().div_ceil(100);
        for offset in 0..order.len() {
            let index = order[(position + offset) % order.len()];
            let known = self
                .0
                .broken
                .lock()
                .unwrap_or_else(PoisonError::into_inner)
                .contains_key(&index);
            if known {
                continue;
            }
            let reason = match self.load(index) {
                Ok(pair) => return Ok((index, pair)),
                Err(reason) => reason,
            };
            let mut broken = self.0.broken.lock().unwrap_or_else(PoisonError::into_inner);
            if broken.insert(index, reason.clone()).is_none() {
                if broken.len() > allowed {
                    return Err(Error::TooManyBroken {
                        broken: broken.len(),
                        pairs: self.count(),
                        last: reason,
                    });
                }
                warnings
                    .lock()
                    .unwrap_or_else(PoisonError::into_inner)
                    .push(format!(
                        "warning: {reason}; another pair takes its place. `prep verify` lists \
                         every damaged file."
                    ));
            }
        }
        Err(Error::TooManyBroken {
            broken: self.count(),
            pairs: self.count(),
            last: "no pair is left".to_owned(),
        })
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    /// Pairs of flat images, red by index, the right view green; those in `broken` are no images.
    pub(in crate::data) fn flat_pairs(
        count: usize,
        broken: &[usize],
    ) -> (tempfile::TempDir, Pairs) {
        let folder = tempfile::tempdir().unwrap();
        let entries = (0..count)
            .map(|index| {
                let [left, right] = [0, 255].map(|green| {
                    let path = folder.path().join(format!("{index}-{green}.png"));
                    if broken.contains(&index) {
                        std::fs::write(&path, b"not an image").unwrap();
                    } else {
                        let colour = image::Rgb([index as u8, green, 0]);
                        RgbImage::from_pixel(16, 8, colour).save(&path).unwrap();
                    }
                    path
                });
                Entry {
                    drive: String::new(),
                    id: index.to_string(),
                    left,
                    right,
                    camera: [0.5 + index as f64 / 16.0, 0.25],
                }
            })
            .collect();
        (folder, Pairs::new(entries, 8, 4, true))
    }

    #[test]
    fn a_camera_is_the_mean_over_the_pairs() {
        let (_folder, pairs) = flat_pairs(3, &[]);
        let camera = pairs.camera().unwrap();
        assert_eq!(camera.focal_fraction.to_string(), "0.5625 0.5 0.625");
        assert_eq!(camera.baseline_m.to_string(), "0.25");
    }
}
