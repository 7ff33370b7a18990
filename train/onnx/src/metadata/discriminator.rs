//! What the file of a discriminator says of itself.
//!
//! Its keys begin with `strat-discriminator.`, so that nothing takes such a file for a depth model.

use std::collections::HashMap;
use std::str::FromStr;

use crate::metadata::probe_image;

/// Version of the keys that this program writes.
const FORMAT: u32 = 1;
const PREFIX: &str = "strat-discriminator.";

/// What `train` tells `bench` about a discriminator: logits for patches of synthesised or real images.
///
/// Its input is `patches`, `[N, 3, patch, patch]` in 0..1, its output `logits`, `[N, 1, g, g]`; above 0 it
/// takes a place for real.
#[derive(Clone, Debug, PartialEq)]
pub struct DiscriminatorMetadata {
    /// Side of the square patches in pixels.
    pub patch: u32,
    /// Width in pixels of the images that patches were cut from in training.
    pub image_width: u32,
    /// Height in pixels of those images.
    pub image_height: u32,
    /// Kernel that these images were resized with, as `prep` names it.
    pub kernel: String,
    /// Digest of the prepared set that it was trained on.
    pub train_data_digest: String,
    /// Name of the training variant.
    pub variant: String,
    /// Seed of the training run.
    pub seed: u64,
    /// Number of epochs that were completed.
    pub epoch: u32,
    /// Version of the program that wrote the file.
    pub tool_version: String,
    /// Largest difference of a logit between the training framework and the written file.
    pub parity: f64,
    /// Logits for [`probe_image`] of the patch's size, from the training framework.
    pub expected: Vec<f32>,
}

impl DiscriminatorMetadata {
    /// Keys and values in a fixed order.
    #[must_use]
    pub fn to_props(&self) -> Vec<(String, String)> {
        let expected: Vec<String> = self.expected.iter().map(f32::to_string).collect();
        [
            ("format", FORMAT.to_string()),
            ("patch", self.patch.to_string()),
            ("image_width", self.image_width.to_string()),
            ("image_height", self.image_height.to_string()),
            ("kernel", self.kernel.clone()),
            ("train_data_digest", self.train_data_digest.clone()),
            ("variant", self.variant.clone()),
            ("seed", self.seed.to_string()),
            ("epoch", self.epoch.to_string()),
            ("tool_version", self.tool_version.clone()),
            ("parity", self.parity.to_string()),
            ("expected", expected.join(" ")),
        ]
        .map(|(key, value)| (format!("{PREFIX}{key}"), value))
        .into()
    }

    /// Reads keys and values of a model file; `None` where it is not the file of a discriminator.
    ///
    /// # Errors
    /// A sentence part: a value is missing, or not what it should be.
    pub fn from_props<'a>(
        props: impl IntoIterator<Item = (&'a str, &'a str)>,
    ) -> Result<Option<Self>, String> {
        let own = props
            .into_iter()
            .filter_map(|(key, value)| Some((key.strip_prefix(PREFIX)?, value)));
        let fields = Fields(own.collect());
        if fields.0.is_empty() {
            return Ok(None);
        }
        let format: u32 = fields.parse("format")?;
        if format > FORMAT {
            return Err(format!(
                "it has format {format}, and this program knows up to {FORMAT}"
            ));
        }
        let size = |key: &str| match fields.parse::<u32>(key)? {
            size @ 1..=16_384 => Ok(size),
            size => Err(format!("\"{PREFIX}{key}\" is {size}, which is no size")),
        };
        let expected: Option<Vec<f32>> = fields
            .get("expected")?
            .split_ascii_whitespace()
            .map(|number| number.parse().ok().filter(|value: &f32| value.is_finite()))
            .collect();
        let found = Self {
            patch: size("patch")?,
            image_width: size("image_width")?,
            image_height: size("image_height")?,
            kernel: fields.parse("kernel")?,
            train_data_digest: fields.parse("train_data_digest")?,
            variant: fields.parse("variant")?,
            seed: fields.parse("seed")?,
            epoch: fields.parse("epoch")?,
            tool_version: fields.parse("tool_version")?,
            parity: fields.parse("parity")?,
            expected: expected.ok_or_else(|| {
                format!("\"{PREFIX}expected\" has something that is not a number")
            })?,
        };
        if found.patch > found.image_width.min(found.image_height) {
            return Err(format!(
                "its patches of {0}x{0} are larger than its images of {1}x{2}",
                found.patch, found.image_width, found.image_height
            ));
        }
        Ok(Some(found))
    }

    /// The input that the expected logits belong to, `[1, 3, patch, patch]`.
    #[must_use]
    pub fn probe_image(&self) -> Vec<f32> {
        probe_image(self.patch, self.patch)
    }

    /// Largest difference of logits to the expected ones; infinite where their number differs or one is
    /// not a number.
    #[must_use]
    pub fn max_difference(&self, logits: &[f32]) -> f32 {
        if logits.len() != self.expected.len() {
            return f32::INFINITY;
        }
        let pairs = logits.iter().zip(&self.expected);
        pairs
            .map(|(found, expected)| (found - expected).abs())
            .map(|difference| {
                if difference.is_nan() {
                    f32::INFINITY
                } else {
                    difference
                }
            })
            .fold(0.0, f32::max)
    }
}

struct Fields<'a>(HashMap<&'a str, &'a str>);

impl<'a> Fields<'a> {
    fn get(&self, key: &str) -> Result<&'a str, String> {
        let found = self.0.get(key).copied();
        found.ok_or_else(|| format!("\"{PREFIX}{key}\" is missing"))
    }

    fn parse<T: FromStr>(&self, key: &str) -> Result<T, String> {
        let text = self.get(key)?;
        let value = text.parse();
        value.map_err(|_| format!("\"{PREFIX}{key}\" cannot be read"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn metadata() -> DiscriminatorMetadata {
        DiscriminatorMetadata {
            patch: 64,
            image_width: 192,
            image_height: 64,
            kernel: "area".to_owned(),
            train_data_digest: "ab".to_owned(),
            variant: "strat".to_owned(),
            seed: 3,
            epoch: 14,
            tool_version: "0.1.0".to_owned(),
            parity: 1e-6,
            expected: vec![0.25, -1.5],
        }
    }

    fn read(props: &[(String, String)]) -> Result<Option<DiscriminatorMetadata>, String> {
        let props = props
            .iter()
            .map(|(key, value)| (key.as_str(), value.as_str()));
        DiscriminatorMetadata::from_props(props)
    }

    #[test]
    fn it_comes_back_as_written() {
        assert_eq!(read(&metadata().to_props()), Ok(Some(metadata())));
        assert_eq!(read(&[("strat.format".into(), "1".into())]), Ok(None));
    }

    #[test]
    fn what_is_wrong_is_named() {
        let with = |key: &str, value: Option<&str>| {
            let key = format!("{PREFIX}{key}");
            let mut props = metadata().to_props();
            let at = props.iter().position(|(name, _)| *name == key).unwrap();
            match value {
                Some(value) => props[at].1 = value.to_owned(),
                None => drop(props.remove(at)),
            }
            read(&props).unwrap_err()
        };
        assert!(with("seed", None).contains("seed\" is missing"));
        assert!(with("patch", Some("0")).contains("no size"));
        assert!(with("patch", Some("65")).contains("larger than its images"));
        assert!(with("expected", Some("0.1 x")).contains("not a number"));
        assert!(with("format", Some("9")).contains("format 9"));
    }

    #[test]
    fn differences_of_logits() {
        assert_eq!(metadata().max_difference(&[0.5, -1.5]), 0.25);
        assert_eq!(metadata().max_difference(&[0.5]), f32::INFINITY);
        assert_eq!(metadata().max_difference(&[f32::NAN, 0.0]), f32::INFINITY);
    }
}
