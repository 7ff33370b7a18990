//! Predictions that some program has saved, evaluated without its model.
//!
//! Four forms: a NumPy array of all maps (`.npy`, as monodepth and monodepth2 write them, or the
//! one of an `.npz`), an `.npz` with an array for each image under its id, as `prep export` writes it,
//! or a folder with a file for each image (16-bit PNG, EXR or `.npy`). What the numbers are is said by a
//! small YAML file ([`SavedDescription`]), never guessed. An array of all says nothing about whose maps
//! they are: `NAME.ids.txt` beside it lists the images, one a line, also in the forms of the published
//! lists; without it there must be as many maps as the split has test images, in published order, or
//! as many as the prepared set has, in its order.
//!
//! Not here: resizing and scoring, which are those of any model ([`crate::evaluate`]).

use std::{
    collections::HashMap,
    fs::File,
    io::Read as _,
    path::{Path, PathBuf},
    sync::{Mutex, PoisonError},
};

use serde::{Deserialize, Serialize};
use strat_onnx::metadata::OutputMeaning;
use strat_store::guard::guarded;
use strat_store::inputs::{self, Kind};
use strat_store::{
    exr, files, image_files, npy,
    raster::Plane,
    set::{Content, Sample},
};

use super::error::{MapFault, SavedError, open, unusable};
use super::find::{files_of, hash_of, ids_of, indices, members_of};
use crate::{
    model::{Sigmoid, ValueEncoding, plausible},
    view::View,
};

/// Description of a folder, in the folder.
pub const FOLDER_DESCRIPTION: &str = "predictions.yaml";

/// What saved numbers are; the YAML file beside them holds exactly this.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SavedDescription {
    /// What the numbers are. Disparity in pixels is in pixels of the saved map.
    pub meaning: OutputMeaning,
    /// A sigmoid to be undone first.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sigmoid: Option<Sigmoid>,
    /// Depth in metres is this many times the depth that the numbers say.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub scale: Option<f64>,
    /// A 16-bit integer, of a PNG or an array, is divided by this; KITTI's own files have 256.
    #[serde(default = "kitti_png", skip_serializing_if = "is_kitti_png")]
    pub png_divisor: f64,
    /// Maps that are as large as their images and yet of another aspect show the whole image,
    /// stretched, and not a part of it.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub stretched: bool,
    /// What of the image a map shows, at any size.
    #[serde(default, skip_serializing_if = "is_whole")]
    pub crop: View,
    /// Name of the array in an `.npz` of several.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub array: Option<String>,
}

#[allow(clippy::trivially_copy_pass_by_ref, reason = "serde asks for it")]
fn is_whole(crop: &View) -> bool {
    *crop == View::Whole
}

fn kitti_png() -> f64 {
    256.0
}

#[allow(clippy::trivially_copy_pass_by_ref, reason = "serde asks for it")]
fn is_kitti_png(divisor: &f64) -> bool {
    *divisor == kitti_png()
}

impl SavedDescription {
    /// ValueEncoding of one meaning to which nothing was done.
    #[must_use]
    pub fn plain(meaning: OutputMeaning) -> Self {
        Self {
            meaning,
            sigmoid: None,
            scale: None,
            png_divisor: kitti_png(),
            stretched: false,
            crop: View::Whole,
            array: None,
        }
    }

    /// What the numbers are, before anything is done to them.
    #[must_use]
    pub fn encoding(&self) -> ValueEncoding {
        ValueEncoding {
            meaning: self.meaning,
            sigmoid: self.sigmoid,
            scale: self.scale,
        }
    }

    /// Makes sure that the description contradicts neither itself nor reason.
    ///
    /// # Errors
    /// It does; a sentence.
    pub fn check(&self) -> Result<(), String> {
        self.encoding().check()?;
        let divisor = self.png_divisor;
        if divisor > 0.0 && divisor.is_finite() {
            Ok(())
        } else {
            Err(format!(
                "`png_divisor` must be a positive number, not {divisor}"
            ))
        }
    }

    /// What the numbers of a map are once it was [taken](Self::take).
    #[must_use]
    pub fn meaning_taken(&self) -> OutputMeaning {
        self.encoding().meaning()
    }

    /// Takes a map as it was predicted: its numbers must be possible; the sigmoid is undone and the
    /// scale brought in.
    ///
    /// # Errors
    /// It holds NaN, infinity or values that its meaning excludes.
    pub fn take(&self, mut map: Plane) -> Result<Plane, MapFault> {
        // Whole pieces without a way out are many values at a time for the processor.
        let usable = |values: &[f32]| {
            values
                .iter()
                .fold(true, |all, value| all & value.is_finite())
        };
        let odd = (!map.data.chunks(1024).all(usable))
            .then(|| map.data.iter().position(|value| !value.is_finite()));
        if let Some(first) = odd.flatten() {
            return Err(MapFault::NotFinite {
                row: first / map.width,
                column: first % map.width,
            });
        }
        let encoding = self.encoding();
        plausible::check_values(&encoding, &map.data, map.width, map.width)
            .map_err(MapFault::Implausible)?;
        encoding.apply(&mut map.data);
        Ok(map)
    }

    /// Makes sure that a map of this size, columns and rows, can show a whole image of that size, or the
    /// crop of it that the description names.
    ///
    /// # Errors
    /// Its shape is that of something else, or the image has no such crop.
    pub fn check_size(&self, map: (usize, usize), image: (usize, usize)) -> Result<(), MapFault> {
        let shown = self.crop.size(image)?;
        if self.stretched {
            return Ok(());
        }
        plausible::check_saved(map, shown).map_err(MapFault::Implausible)
    }
}

/// Opened predictions.
#[derive(Debug)]
pub struct SavedPredictions {
    /// Name used in tables.
    pub name: String,
    /// File or folder.
    pub path: PathBuf,
    /// BLAKE3 of the file; of a folder, that of the names and BLAKE3 of its maps.
    pub blake3: String,
    /// BLAKE3 of the list that says which map belongs to which image, one id a line.
    pub images_digest: String,
    /// What the numbers are.
    pub description: SavedDescription,
    maps: Maps,
}

#[derive(Debug)]
enum Maps {
    Array {
        planes: Mutex<npy::Planes>,
        indices: HashMap<String, usize>,
    },
    /// Arrays of an `.npz`, one for each image, by their names without `.npy`.
    Members(HashMap<String, String>),
    Files(HashMap<String, PathBuf>),
}

impl SavedPredictions {
    /// Opens predictions for the test images of a set.
    ///
    /// # Errors
    /// They cannot be read, nobody says what they are, or it is not clear whose they are.
    pub fn open(
        name: &str,
        path: &Path,
        content: Content,
        samples: &[Sample],
    ) -> Result<Self, SavedError> {
        let folder = path.is_dir();
        // A missing file is a clearer message than its missing description.
        let bytes = if folder { None } else { Some(open(path)?) };
        let yaml = if folder {
            path.join(FOLDER_DESCRIPTION)
        } else {
            path.with_extension("yaml")
        };
        if !yaml.is_file() {
            return Err(SavedError::Undescribed {
                path: path.to_path_buf(),
                yaml,
            });
        }
        let description: SavedDescription = strat_store::yaml::load(&yaml)?;
        let checked = description.check();
        checked.map_err(|reason| unusable(&yaml, reason))?;
        let members = match description.array {
            None => members_of(path, samples)?,
            Some(_) => None,
        };
        let (maps, blake3, images) = match bytes {
            Some(_) if members.is_some() => {
                let members = members.unwrap_or_default();
                let images = samples.iter().map(|sample| sample.id.as_str());
                let images: Vec<&str> = images.filter(|id| members.contains_key(*id)).collect();
                let images = images.join("\n");
                (
                    Maps::Members(members),
                    files::blake3_file(path, Kind::Maps)?,
                    images,
                )
            }
            Some(file) => {
                let planes = array(path, file, description.array.as_deref())?;
                let ids = ids_of(path, planes.count, content, samples)?;
                let images = ids.join("\n");
                let indices = indices(path, ids)?;
                let planes = Mutex::new(planes);
                let maps = Maps::Array { planes, indices };
                (maps, files::blake3_file(path, Kind::Maps)?, images)
            }
            None => {
                let found = files_of(path, samples)?;
                let blake3 = hash_of(samples, &found)?;
                let images = samples.iter().map(|sample| sample.id.as_str());
                let images: Vec<&str> = images.filter(|id| found.contains_key(*id)).collect();
                let images = images.join("\n");
                (Maps::Files(found), blake3, images)
            }
        };
        Ok(Self {
            name: name.to_owned(),
            path: path.to_path_buf(),
            blake3,
            images_digest: files::blake3_hex(images.as_bytes()),
            description,
            maps,
        })
    }

    /// What the numbers of [`map`](Self::map) are.
    #[must_use]
    pub fn meaning(&self) -> OutputMeaning {
        self.description.meaning_taken()
    }

    /// The map of one image.
    ///
    /// # Errors
    /// There is none, it is broken, or it holds NaN, infinity or values that its meaning excludes.
    pub fn map(&self, image: &str) -> Result<Plane, SavedError> {
        let missing = || SavedError::Missing {
            path: self.path.clone(),
        };
        let (path, plane) = match &self.maps {
            Maps::Array { planes, indices } => {
                let index = *indices.get(image).ok_or_else(missing)?;
                let mut planes = planes.lock().unwrap_or_else(PoisonError::into_inner);
                (&self.path, self.plane(&self.path, &mut planes, index)?)
            }
            Maps::Members(members) => {
                let member = members.get(image).ok_or_else(missing)?;
                let mut planes = array(&self.path, open(&self.path)?, Some(member))?;
                (&self.path, self.only_plane(&self.path, &mut planes)?)
            }
            Maps::Files(files) => {
                let path = files.get(image).ok_or_else(missing)?;
                (path, self.decode(path)?)
            }
        };
        self.description
            .take(plane)
            .map_err(|fault| fault_in(path, fault))
    }

    /// The map of one image, which must show the whole image or the crop that the description names.
    ///
    /// # Errors
    /// As [`map`](Self::map), its shape is that of something else, or the image has no such crop.
    pub fn map_of(&self, sample: &Sample) -> Result<Plane, SavedError> {
        let plane = self.map(&sample.id)?;
        let image = (sample.width as usize, sample.height as usize);
        self.description
            .check_size((plane.width, plane.height), image)
            .map_err(|fault| {
                let path = match &self.maps {
                    Maps::Files(files) => files.get(&sample.id),
                    Maps::Array { .. } | Maps::Members(_) => None,
                };
                fault_in(path.unwrap_or(&self.path), fault)
            })?;
        Ok(plane)
    }

    /// A map of an array; 16-bit integers are divided as those of a PNG.
    fn plane(
        &self,
        path: &Path,
        planes: &mut npy::Planes,
        index: usize,
    ) -> Result<Plane, SavedError> {
        let mut data = planes
            .plane(index)
            .map_err(|reason| unusable(path, reason))?;
        if planes.are_integers {
            let divisor = self.description.png_divisor;
            data.iter_mut()
                .for_each(|value| *value = (f64::from(*value) / divisor) as f32);
        }
        Ok(Plane {
            width: planes.width,
            height: planes.height,
            data,
        })
    }

    /// The map of an array of one.
    fn only_plane(&self, path: &Path, planes: &mut npy::Planes) -> Result<Plane, SavedError> {
        if planes.count == 1 {
            return self.plane(path, planes, 0);
        }
        let reason = format!(
            "it holds {} maps, but is to be that of one image",
            planes.count
        );
        Err(unusable(path, reason))
    }

    fn decode(&self, path: &Path) -> Result<Plane, SavedError> {
        let ending = path.extension().and_then(|ending| ending.to_str());
        if ending == Some("npy") {
            let mut planes = array(path, open(path)?, None)?;
            return self.only_plane(path, &mut planes);
        }
        let bytes = inputs::read(path, Kind::of_extension(ending.unwrap_or("")))?;
        if ending == Some("exr") {
            return exr::decode_channel(&bytes).map_err(|reason| unusable(path, reason));
        }
        let (width, height, values) =
            image_files::decode_gray16(&bytes, &path.display().to_string())?;
        let divisor = self.description.png_divisor;
        Ok(Plane {
            width,
            height,
            data: values
                .into_iter()
                .map(|value| (f64::from(value) / divisor) as f32)
                .collect(),
        })
    }
}

fn fault_in(path: &Path, fault: MapFault) -> SavedError {
    SavedError::Map {
        path: path.to_owned(),
        fault,
    }
}

/// An array of an `.npy` or, unpacked into a file without a name, of an `.npz`.
fn array(path: &Path, file: File, member: Option<&str>) -> Result<npy::Planes, SavedError> {
    let wrong = |reason: String| unusable(path, reason);
    if path.extension().is_none_or(|ending| ending != "npz") {
        return npy::Planes::new(file).map_err(wrong);
    }
    let damaged = |error: zip::result::ZipError| wrong(format!("it is not a usable .npz: {error}"));
    let mut archive = guarded("the zip reader", || zip::ZipArchive::new(file))
        .map_err(wrong)?
        .map_err(damaged)?;
    let names: Vec<String> = archive
        .file_names()
        .map(|name| name.map(std::borrow::Cow::into_owned))
        .collect::<Result<_, _>>()
        .map_err(damaged)?;
    let wanted = match (member, names.as_slice()) {
        (Some(member), _) => format!("{member}.npy"),
        (None, [only]) => only.clone(),
        (None, _) => {
            let arrays: Vec<&str> = names.iter().map(|n| n.trim_end_matches(".npy")).collect();
            return Err(wrong(format!(
                "it holds {} arrays; say which with `array:` in its description: {}",
                arrays.len(),
                arrays.join(", ")
            )));
        }
    };
    let mut packed = archive.by_name(&wanted).map_err(|_| {
        wrong(format!(
            "it has no array {}; it has {}",
            wanted.trim_end_matches(".npy"),
            names.join(", ")
        ))
    })?;
    // As long as it says it is, and no longer: a damaged archive must not fill the disk.
    let length = packed.size();
    Kind::Maps.check(&path.join(&wanted), length)?;
    let mut unpack = || -> std::io::Result<File> {
        let mut unpacked = tempfile::tempfile()?;
        std::io::copy(&mut (&mut packed).take(length), &mut unpacked)?;
        Ok(unpacked)
    };
    let unpacked = guarded("the zip reader", &mut unpack).map_err(wrong)?;
    let unpacked = unpacked.map_err(|error| wrong(format!("{wanted} of it: {error}")))?;
    npy::Planes::new(unpacked).map_err(wrong)
}
