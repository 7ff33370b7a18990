//! Cut-outs with transparency: the embedded ones, or a folder of the user's own.
//!
//! A folder holds RGBA PNG files and `sprites.yaml`, which says of each what it shows, how high
//! it is in reality and where it touches the ground ([`SpriteEntry`]). What is opaque (alpha
//! above one half) is the object; what is fainter, such as a shadow, is drawn but never measured.

use std::path::{Path, PathBuf};

use image::{ImageFormat, RgbaImage};
use serde::{Deserialize, Serialize};
use strat_store::guard::guarded;
use strat_store::inputs::{self, Kind};
use strat_store::{files, yaml};

/// File that describes a folder of sprites.
pub const DESCRIPTION: &str = "sprites.yaml";

/// Sides longer than this are refused: no composite shows more than a few hundred pixels of it.
const LONGEST_SIDE: u32 = 4096;

/// Least mean difference of CIE L* between the two conditions of the contrast experiment
/// (PROTOCOL 5.2).
pub const LUMINANCE_CONTRAST: f64 = 40.0;

/// Why a sprite cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum SpriteError {
    /// The folder or one of its files could not be read.
    #[error(transparent)]
    Store(#[from] strat_store::Error),
    /// The picture cannot be decoded.
    #[error("the sprite {} is not a usable PNG: {reason}", path.display())]
    Decode {
        /// The file.
        path: PathBuf,
        /// The decoder's words.
        reason: String,
    },
    /// There is nothing to tell the object from what is around it.
    #[error(
        "the sprite {} {problem}; it must be an RGBA PNG that is transparent around the object",
        path.display()
    )]
    Alpha {
        /// The file.
        path: PathBuf,
        /// What is wrong with its alpha.
        problem: &'static str,
    },
    /// The picture is too large to be meant.
    #[error(
        "the sprite {} is {width}x{height}; at most {LONGEST_SIDE} pixels a side are taken",
        path.display()
    )]
    TooLarge {
        /// The file.
        path: PathBuf,
        /// Its width.
        width: u32,
        /// Its height.
        height: u32,
    },
    /// An entry of the description contradicts itself or the picture.
    #[error("the sprite {} in {DESCRIPTION}: {problem}", path.display())]
    Entry {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        problem: String,
    },
    /// The description names nothing that the experiments could use.
    #[error("{} has no {what}; the experiments need one", path.display())]
    NoneOf {
        /// The description.
        path: PathBuf,
        /// What is missing.
        what: &'static str,
    },
    /// The sprite cannot be made so much lighter or darker.
    #[error(
        "the sprite \"{name}\" cannot be given another luminance: {reached:.0} of L* is all that \
         fits, {LUMINANCE_CONTRAST} are needed"
    )]
    NoContrast {
        /// The sprite.
        name: String,
        /// Mean difference that can be had.
        reached: f64,
    },
}

/// From where an object is seen.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum View {
    /// From behind.
    Rear,
    /// From its side.
    Side,
}

/// What `sprites.yaml` says of one file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SpriteEntry {
    /// File name within the folder.
    pub file: String,
    /// What it shows; `car`, `pedestrian` and `crate` are those of the thesis.
    pub name: String,
    /// From where it is seen; left out where that makes no difference.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub view: Option<View>,
    /// Whether a network trained on streets has seen such objects.
    pub familiar: bool,
    /// Real height in metres of what is opaque.
    pub height_m: f64,
    /// Where it stands on the ground: column and row, in pixels from the top left corner; the
    /// middle of the lower edge of what is opaque when left out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub anchor: Option<[f64; 2]>,
}

/// The content of `sprites.yaml`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SpriteFile {
    /// One entry for each file.
    pub sprites: Vec<SpriteEntry>,
}

/// A cut-out that can be pasted.
#[derive(Clone, Debug)]
pub struct Sprite {
    /// What it shows.
    pub name: String,
    /// From where it is seen.
    pub view: Option<View>,
    /// Whether a network trained on streets has seen such objects.
    pub familiar: bool,
    /// Real height in metres of what is opaque.
    pub height_m: f64,
    /// Column and row where it stands on the ground.
    pub anchor: [f64; 2],
    /// Left, top, right and bottom edge of what is opaque.
    pub opaque: [f64; 4],
    /// BLAKE3 of its file.
    pub blake3: String,
    /// The picture, not premultiplied.
    pub image: RgbaImage,
}

impl Sprite {
    /// Decodes a file and checks it against its entry; `path` is for messages.
    ///
    /// # Errors
    /// No PNG, no alpha, nothing opaque or nothing transparent, too large, or an entry with a
    /// height or anchor that cannot be.
    pub fn decode(bytes: &[u8], entry: &SpriteEntry, path: &Path) -> Result<Self, SpriteError> {
        let undecodable_because = |reason: String| SpriteError::Decode {
            path: path.to_path_buf(),
            reason,
        };
        let undecodable = |error: image::ImageError| undecodable_because(error.to_string());
        let wrong = |problem: String| SpriteError::Entry {
            path: path.to_path_buf(),
            problem,
        };
        if !(entry.height_m.is_finite() && entry.height_m > 0.0) {
            return Err(wrong("`height_m` must be a number above 0".to_owned()));
        }
        if entry.name.trim().is_empty() {
            return Err(wrong("`name` is empty".to_owned()));
        }
        let mut reader = image::ImageReader::new(std::io::Cursor::new(bytes));
        reader.set_format(ImageFormat::Png);
        let (width, height) = reader.into_dimensions().map_err(undecodable)?;
        if width.max(height) > LONGEST_SIDE {
            return Err(SpriteError::TooLarge {
                path: path.to_path_buf(),
                width,
                height,
            });
        }
        let image = guarded("the image decoder", || {
            image::load_from_memory_with_format(bytes, ImageFormat::Png)
        });
        let image = image.map_err(undecodable_because)?.map_err(undecodable)?;
        let alpha = |problem| SpriteError::Alpha {
            path: path.to_path_buf(),
            problem,
        };
        if !image.color().has_alpha() {
            return Err(alpha("has no alpha channel"));
        }
        let image = image.into_rgba8();
        if image.pixels().all(|pixel| pixel.0[3] == 255) {
            return Err(alpha("is opaque everywhere"));
        }
        let mut opaque: Option<[u32; 4]> = None;
        for (x, y, pixel) in image.enumerate_pixels() {
            if pixel.0[3] > 127 {
                let [left, top, right, bottom] = opaque.unwrap_or([x, y, x + 1, y + 1]);
                opaque = Some([left.min(x), top.min(y), right.max(x + 1), bottom.max(y + 1)]);
            }
        }
        let opaque = opaque
            .ok_or_else(|| alpha("is opaque nowhere"))?
            .map(f64::from);
        let anchor = entry
            .anchor
            .unwrap_or([0.5 * (opaque[0] + opaque[2]), opaque[3]]);
        let within = |place: f64, size: u32| (0.0..=f64::from(size)).contains(&place);
        if !(within(anchor[0], width) && within(anchor[1], height)) || anchor[1] <= opaque[1] {
            return Err(wrong(format!(
                "`anchor` {anchor:?} must lie in the picture ({width}x{height}) and below the top of \
                 the object"
            )));
        }
        Ok(Self {
            name: entry.name.clone(),
            view: entry.view,
            familiar: entry.familiar,
            height_m: entry.height_m,
            anchor,
            opaque,
            blake3: files::blake3_hex(bytes),
            image,
        })
    }

    /// Pixels from the top of what is opaque to the ground.
    #[must_use]
    pub fn height_px(&self) -> f64 {
        self.anchor[1] - self.opaque[1]
    }

    /// Width of what is opaque for each pixel of its height.
    #[must_use]
    pub fn aspect(&self) -> f64 {
        (self.opaque[2] - self.opaque[0]) / self.height_px()
    }

    /// The same sprite with its CIE L* shifted until the mean over what is opaque differs by at
    /// least [`LUMINANCE_CONTRAST`]; a dark sprite is made lighter, a light one darker.
    ///
    /// # Errors
    /// The colours' range does not hold such a shift.
    pub fn with_other_luminance(&self) -> Result<Self, SpriteError> {
        let solid: Vec<[f64; 3]> = self
            .image
            .pixels()
            .filter(|pixel| pixel.0[3] > 127)
            .map(|pixel| lab([pixel.0[0], pixel.0[1], pixel.0[2]]))
            .collect();
        let mean = solid.iter().map(|lab| lab[0]).sum::<f64>() / solid.len() as f64;
        let sign = if mean < 50.0 { 1.0 } else { -1.0 };
        let reached = |shift: f64| {
            let sum: f64 = solid
                .iter()
                .map(|&[l, a, b]| (lab(rgb([l + sign * shift, a, b]))[0] - l).abs())
                .sum();
            sum / solid.len() as f64
        };
        let shift = (40..=100)
            .map(f64::from)
            .find(|&shift| reached(shift) >= LUMINANCE_CONTRAST)
            .ok_or_else(|| SpriteError::NoContrast {
                name: self.name.clone(),
                reached: reached(100.0),
            })?;
        let mut other = self.clone();
        // What is fainter is not the object.
        for pixel in other.image.pixels_mut().filter(|pixel| pixel.0[3] > 127) {
            let [r, g, b, alpha] = pixel.0;
            let [l, a, bb] = lab([r, g, b]);
            let [r, g, b] = rgb([l + sign * shift, a, bb]);
            pixel.0 = [r, g, b, alpha];
        }
        Ok(other)
    }
}

/// The sprites that come with the program, drawn by `bench/sprites/draw.rs`.
///
/// # Errors
/// Never in a sound build; tests hold that.
pub fn embedded() -> Result<Vec<Sprite>, SpriteError> {
    const FILES: [(&str, &[u8]); 5] = [
        ("car_rear.png", include_bytes!("../../sprites/car_rear.png")),
        ("car_side.png", include_bytes!("../../sprites/car_side.png")),
        (
            "pedestrian_rear.png",
            include_bytes!("../../sprites/pedestrian_rear.png"),
        ),
        (
            "pedestrian_side.png",
            include_bytes!("../../sprites/pedestrian_side.png"),
        ),
        ("crate.png", include_bytes!("../../sprites/crate.png")),
    ];
    let description: SpriteFile = serde_yaml::from_str(include_str!("../../sprites/sprites.yaml"))
        .map_err(|error| SpriteError::Entry {
            path: PathBuf::from(DESCRIPTION),
            problem: error.to_string(),
        })?;
    description
        .sprites
        .iter()
        .filter_map(|entry| {
            let (name, bytes) = FILES.iter().find(|(name, _)| *name == entry.file)?;
            Some(Sprite::decode(bytes, entry, Path::new(name)))
        })
        .collect()
}

/// The sprites of a folder with a `sprites.yaml`.
///
/// # Errors
/// The description or a picture cannot be used; the message names it.
pub fn read_folder(folder: &Path) -> Result<Vec<Sprite>, SpriteError> {
    let path = folder.join(DESCRIPTION);
    let description: SpriteFile = yaml::load(&path)?;
    let sprites: Vec<Sprite> = description
        .sprites
        .iter()
        .map(|entry| {
            let path = folder.join(&entry.file);
            Sprite::decode(&inputs::read(&path, Kind::Image)?, entry, &path)
        })
        .collect::<Result<_, _>>()?;
    if sprites.is_empty() {
        return Err(SpriteError::NoneOf {
            path,
            what: "sprite",
        });
    }
    Ok(sprites)
}

/// sRGB to CIE L*a*b* under D65.
fn lab(rgb: [u8; 3]) -> [f64; 3] {
    let linear = rgb.map(|byte| {
        let c = f64::from(byte) / 255.0;
        if c <= 0.040_45 {
            c / 12.92
        } else {
            ((c + 0.055) / 1.055).powf(2.4)
        }
    });
    let [r, g, b] = linear;
    let f = |t: f64| {
        if t > 216.0 / 24389.0 {
            t.cbrt()
        } else {
            (24389.0 / 27.0 * t + 16.0) / 116.0
        }
    };
    let x = f((0.412_456_4 * r + 0.357_576_1 * g + 0.180_437_5 * b) / 0.950_47);
    let y = f(0.212_672_9 * r + 0.715_152_2 * g + 0.072_175 * b);
    let z = f((0.019_333_9 * r + 0.119_192 * g + 0.950_304_1 * b) / 1.088_83);
    [116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)]
}

/// CIE L*a*b* under D65 to sRGB, clipped to its range.
fn rgb([l, a, b]: [f64; 3]) -> [u8; 3] {
    let y = (l.clamp(0.0, 100.0) + 16.0) / 116.0;
    let inverse = |t: f64| {
        if t > 6.0 / 29.0 {
            t * t * t
        } else {
            (116.0 * t - 16.0) * 27.0 / 24389.0
        }
    };
    let (x, y, z) = (
        0.950_47 * inverse(y + a / 500.0),
        inverse(y),
        1.088_83 * inverse(y - b / 200.0),
    );
    [
        3.240_454_2 * x - 1.537_138_5 * y - 0.498_531_4 * z,
        -0.969_266 * x + 1.876_010_8 * y + 0.041_556 * z,
        0.055_643_4 * x - 0.204_025_9 * y + 1.057_225_2 * z,
    ]
    .map(|c| {
        let c = c.clamp(0.0, 1.0);
        let encoded = if c <= 0.003_130_8 {
            12.92 * c
        } else {
            1.055 * c.powf(1.0 / 2.4) - 0.055
        };
        (255.0 * encoded).round() as u8
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn colours_survive_the_way_through_lab() {
        assert!((lab([255, 255, 255])[0] - 100.0).abs() < 1e-3);
        // Mid grey, worked out from the definition: Y = 0.2122, L = 116 * 0.5964 - 16.
        assert!((lab([127, 127, 127])[0] - 53.19).abs() < 0.05);
        for colour in [[0, 0, 0], [12, 200, 77], [255, 0, 255], [3, 3, 250]] {
            assert_eq!(rgb(lab(colour)), colour);
        }
    }

    #[test]
    fn embedded_sprites_are_sound_and_can_be_contrasted() {
        let sprites = embedded().unwrap();
        let names: Vec<&str> = sprites.iter().map(|sprite| sprite.name.as_str()).collect();
        assert_eq!(names, ["car", "car", "pedestrian", "pedestrian", "crate"]);
        for sprite in &sprites {
            let other = sprite.with_other_luminance().unwrap();
            let (mut sum, mut count) = (0.0, 0.0);
            for (a, b) in sprite.image.pixels().zip(other.image.pixels()) {
                assert_eq!(a.0[3], b.0[3]);
                if a.0[3] > 127 {
                    let l = |p: &image::Rgba<u8>| lab([p.0[0], p.0[1], p.0[2]])[0];
                    sum += (l(a) - l(b)).abs();
                    count += 1.0;
                }
            }
            assert!(sum / count >= LUMINANCE_CONTRAST - 0.5, "{}", sum / count);
        }
    }
}
