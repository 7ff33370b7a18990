//! Whether a map can be what its description says it is: its shape beside what it maps, its values
//! beside their meaning.
//!
//! Every map of a model and every saved map passes here, so that a wrong word in a description ends
//! in a sentence and not in a figure. What is possible but unlikely is not refused here;
//! [`crate::evaluate::agreement`] looks at it beside the ground truth.

use strat_onnx::metadata::{InputRange, OutputMeaning};

use super::{
    description::{Fit, InputCrop, InputDescription, ValueEncoding},
    error::Implausible,
};

/// How far outside 0..1 the value of a sigmoid may be rounded.
const SIGMOID_TOLERANCE: f32 = 1e-3;

/// Relative difference of two aspects that counts as rounding of sizes.
const ASPECT_TOLERANCE: f64 = 0.02;

/// A saved map that is as large as its image to this share is meant to have the image's pixels.
const IMAGE_SIZED: std::ops::RangeInclusive<f64> = 0.9..=1.1;

type Size = (usize, usize);

/// Two sizes of one picture: they agree in aspect, or would before their sides were rounded.
fn is_same_aspect((width, height): Size, (of_width, of_height): Size) -> bool {
    let [width, height, of_width, of_height] =
        [width, height, of_width, of_height].map(|n| n as f64);
    let ratio = (width / of_width) / (height / of_height);
    // Each side of a map at a coarser stride is rounded by up to a pixel.
    let scales = |side: f64, of: f64| ((side - 1.0) / of, (side + 1.0) / of);
    let (across, down) = (scales(width, of_width), scales(height, of_height));
    (ratio - 1.0).abs() <= ASPECT_TOLERANCE || (across.0 < down.1 && down.0 < across.1)
}

/// A network's map shows what its input, of a size in pixels, shows.
///
/// # Errors
/// Its aspect is another one.
pub(super) fn check_output(map: Size, of: Size) -> Result<(), Implausible> {
    if is_same_aspect(map, of) {
        return Ok(());
    }
    let hint = if is_same_aspect((map.1, map.0), of) {
        "its rows and columns seem to be swapped"
    } else {
        "`layout` (nchw or nhwc) and `channel` of the description's output decide what is taken for \
         rows and columns; each of input and output has its own `layout`"
    };
    Err(aspect(map, "an input", of, hint))
}

/// A saved map shows a whole image: at its aspect, or at the smaller size of a network that is shown
/// the image at an aspect of its own.
///
/// # Errors
/// Its rows and columns are swapped, or it is as large as the image and yet of another aspect, like
/// a map of a part of it.
pub fn check_saved(map: Size, image: Size) -> Result<(), Implausible> {
    if is_same_aspect(map, image) {
        return Ok(());
    }
    let share = |side: usize, of: usize| side as f64 / of as f64;
    let (across, down) = (share(map.0, image.0), share(map.1, image.1));
    let is_upright = |(width, height): Size| height > width;
    if is_upright(map) != is_upright(image) && map.0 != map.1 {
        let hint = "its rows and columns seem to be swapped; save it as [rows, columns]";
        return Err(aspect(map, "an image", image, hint));
    }
    if IMAGE_SIZED.contains(&across) && IMAGE_SIZED.contains(&down) {
        let hint = "it seems to be cropped or padded; save the map of the whole image, or write \
                    `crop: kitti-benchmark` into the description if it shows KITTI's benchmark crop, \
                    or `stretched: true` if the network was shown the whole image at this size";
        return Err(aspect(map, "an image", image, hint));
    }
    Ok(())
}

fn aspect(map: Size, what: &'static str, of: Size, hint: &'static str) -> Implausible {
    Implausible::Aspect {
        width: map.0,
        height: map.1,
        what,
        of_width: of.0,
        of_height: of.1,
        hint,
    }
}

/// Values as they come, before the sigmoid is undone and the scale brought in.
///
/// `map_width` is the width of the map, `pixel_width` the width that disparity in pixels is
/// measured in.
///
/// # Errors
/// One of them cannot be.
pub fn check_values(
    encoding: &ValueEncoding,
    values: &[f32],
    map_width: usize,
    pixel_width: usize,
) -> Result<(), Implausible> {
    let (min, max, rule) = if encoding.sigmoid.is_some() {
        let (min, max) = (-SIGMOID_TOLERANCE, 1.0 + SIGMOID_TOLERANCE);
        let rule = "a sigmoid lies between 0 and 1; is the sigmoid undone already, or `channel` or \
                    `name` another output?";
        (min, max, rule.to_owned())
    } else {
        match encoding.meaning {
            OutputMeaning::DisparityFraction => (
                f32::MIN,
                1.0,
                "a disparity cannot be larger than the whole width of the image; are these pixels \
                 (`meaning: disparity_px`)?"
                    .to_owned(),
            ),
            OutputMeaning::DisparityPx => (
                f32::MIN,
                pixel_width as f32,
                format!(
                    "a disparity cannot be larger than the {pixel_width} pixels of the width; is this \
                     depth (`meaning: depth_m`), or are these numbers for a `png_divisor`?"
                ),
            ),
            OutputMeaning::DepthM => (
                0.0,
                f32::MAX,
                "depth cannot be negative; are these other numbers than `meaning: depth_m` says?"
                    .to_owned(),
            ),
            OutputMeaning::InverseDepth
            | OutputMeaning::InverseDepthPerM
            | OutputMeaning::Depth => return Ok(()),
        }
    };
    let is_outside = |value: f32| value < min || value > max;
    // Whole pieces without a way out are many values at a time for the processor.
    let mut pieces = values.chunks(1024);
    let all_inside = pieces.all(|piece| !piece.iter().fold(false, |any, &v| any | is_outside(v)));
    if all_inside {
        return Ok(());
    }
    let index = values.iter().position(|&value| is_outside(value));
    let index = index.unwrap_or_default();
    Err(Implausible::Value {
        value: values[index],
        row: index / map_width.max(1),
        column: index % map_width.max(1),
        rule,
    })
}

impl InputDescription {
    /// # Errors
    /// Sizes, means or deviations that no input has; a sentence.
    pub(super) fn check(&self) -> Result<(), String> {
        self.check_size()?;
        let (top, text, other) = match self.range {
            InputRange::Unit => (1.0, "0..1", "0..255"),
            InputRange::Bytes => (255.0, "0..255", "0..1"),
        };
        let mean = self.mean.iter().all(|mean| (0.0..=top).contains(mean));
        let std = self.std.iter().all(|std| *std > 0.0 && *std <= top);
        if mean && std {
            return Ok(());
        }
        Err(format!(
            "`{}` must be in units of `range`, from 0 to {top} for {text}, not {:?}; write the range \
             for which it was computed (`range: {other}`?), or convert it",
            if mean { "std" } else { "mean" },
            if mean { self.std } else { self.mean },
        ))
    }

    fn check_size(&self) -> Result<(), String> {
        let is_fixed = match (self.width, self.height) {
            (Some(1..), Some(1..)) => true,
            (None, None) => false,
            (Some(_), Some(_)) => {
                return Err("`width` and `height` of the input must be at least 1".to_owned());
            }
            (width, _) => {
                let missing = if width.is_some() { "height" } else { "width" };
                return Err(format!(
                    "`{missing}` of the input is missing; write both, or neither where the size depends on \
                     the image (`fit: keep-aspect`)"
                ));
            }
        };
        if self.fit == Fit::Stretch && !is_fixed {
            return Err(
                "`width` and `height` of the input are needed; where they depend on the image, write `fit: \
                 keep-aspect` with `shorter_side` and `multiple_of`"
                    .to_owned(),
            );
        }
        for (key, value) in [
            ("shorter_side", self.shorter_side),
            ("multiple_of", self.multiple_of),
        ] {
            match value {
                Some(0) => return Err(format!("`{key}` of the input must be at least 1")),
                Some(_) if is_fixed => {
                    return Err(format!(
                        "`{key}` is for inputs whose size depends on the image, and this one has `width` \
                         and `height`"
                    ));
                }
                _ => {}
            }
        }
        if self.pad.is_some() && !(is_fixed && self.fit == Fit::KeepAspect) {
            return Err(
                "`pad` is for pictures that keep their aspect in an input of one size: `fit: keep-aspect` \
                 with `width` and `height`"
                    .to_owned(),
            );
        }
        if let Some(InputCrop::Pixels {
            rows: [top, bottom],
            columns: [left, right],
        }) = self.crop
            && (top >= bottom || left >= right)
        {
            return Err(format!(
                "`crop` is rows {top} to {bottom} and columns {left} to {right}, which is not a box"
            ));
        }
        Ok(())
    }

    /// What is possible, but looks like another range; a sentence.
    pub(super) fn doubt(&self) -> Option<String> {
        let small = |values: [f32; 3]| values.iter().all(|value| *value <= 1.0);
        let is_default = self.mean == [0.0; 3] && self.std == [1.0; 3];
        let doubtful =
            self.range == InputRange::Bytes && !is_default && small(self.mean) && small(self.std);
        doubtful.then(|| {
            format!(
                "`mean` {:?} and `std` {:?} look like those of `range: 0..1`, but the description says \
                 0..255",
                self.mean, self.std
            )
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::Sigmoid;

    #[test]
    fn outputs_have_the_aspect_of_their_input() {
        for map in [(640, 192), (320, 96), (20, 6), (1280, 384)] {
            assert_eq!(check_output(map, (640, 192)), Ok(()), "{map:?}");
        }
        // A stride of 32 rounds 1242 x 375 to 39 x 12 or cuts it to 38 x 11.
        for map in [(39, 12), (38, 11)] {
            assert_eq!(check_output(map, (1242, 375)), Ok(()), "{map:?}");
        }
        // [1, 96, 160, 1] read as [1, channels, rows, columns].
        let error = check_output((1, 160), (160, 96)).unwrap_err().to_string();
        assert!(
            error.contains("1x160") && error.contains("`layout`"),
            "{error}"
        );
        let error = check_output((96, 160), (160, 96)).unwrap_err().to_string();
        assert!(error.contains("swapped"), "{error}");
    }

    #[test]
    fn saved_maps_show_whole_images() {
        let kitti = (1242, 375);
        // The image's own size, other drives' sizes, halves, and networks of any aspect.
        let good = [
            (1242, 375),
            (1224, 370),
            (1241, 376),
            (621, 188),
            (512, 256),
            (640, 192),
            (1024, 320),
            (416, 128),
            (384, 384),
            (1248, 384),
        ];
        for map in good {
            assert_eq!(check_saved(map, kitti), Ok(()), "{map:?}");
        }
        for (map, word) in [
            ((375, 1242), "swapped"),
            ((256, 512), "swapped"),
            ((1216, 352), "cropped"),
        ] {
            let error = check_saved(map, kitti).unwrap_err().to_string();
            assert!(error.contains(word), "{map:?}: {error}");
        }
    }

    #[test]
    fn values_are_held_against_their_meaning() {
        let encoding = |meaning, sigmoid| ValueEncoding {
            meaning,
            sigmoid,
            scale: None,
        };
        let sigmoid = Some(Sigmoid {
            min_depth: 0.1,
            max_depth: 100.0,
        });
        use OutputMeaning::*;
        for (meaning, sigmoid, good, bad, word) in [
            (
                DisparityFraction,
                None,
                [-0.1, 0.0, 1.0],
                1.01,
                "disparity_px",
            ),
            (DisparityPx, None, [-0.1, 0.0, 64.0], 64.5, "64 pixels"),
            (DepthM, None, [0.0, 3.0, 1e6], -0.01, "negative"),
            (InverseDepth, sigmoid, [0.0, 0.5, 1.0], 1.5, "sigmoid"),
            (InverseDepth, sigmoid, [0.0, 0.5, 1.0], -0.1, "sigmoid"),
        ] {
            let check = |values: &[f32]| check_values(&encoding(meaning, sigmoid), values, 2, 64);
            assert_eq!(check(&good), Ok(()), "{meaning}");
            let error = check(&[good[0], good[1], good[2], bad])
                .unwrap_err()
                .to_string();
            assert!(
                error.contains("row 1, column 1") && error.contains(word),
                "{error}"
            );
        }
        let unknown = encoding(InverseDepth, None);
        assert_eq!(check_values(&unknown, &[-5.0, 400.0], 2, 64), Ok(()));
    }

    #[test]
    fn mean_and_std_are_in_units_of_the_range() {
        let mut input = InputDescription::fixed(64, 32, InputRange::Unit);
        input.mean = [0.485, 0.456, 0.406];
        input.std = [0.229, 0.224, 0.225];
        assert_eq!((input.check(), input.doubt()), (Ok(()), None));
        input.range = InputRange::Bytes;
        assert_eq!(input.check(), Ok(()));
        assert!(input.doubt().unwrap().contains("0..1"));
        input.mean = [123.675, 116.28, 103.53];
        input.std = [58.395, 57.12, 57.375];
        assert_eq!((input.check(), input.doubt()), (Ok(()), None));
        input.range = InputRange::Unit;
        assert!(input.check().unwrap_err().contains("`mean`"));
        input.mean = [0.5; 3];
        assert!(input.check().unwrap_err().contains("`std`"));
        input.std = [0.5, 0.0, 0.5];
        assert!(input.check().is_err());
        input.std = [f32::NAN; 3];
        assert!(input.check().is_err());
    }
}
