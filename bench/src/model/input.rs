//! From an image to the tensor that a model takes, and what of the image it shows (PROTOCOL 10.5).

use image::RgbImage;
use strat_metrics::{CropBox, benchmark_box};
use strat_onnx::{
    graph::{Dim, dims_text},
    metadata::InputRange,
    model::{ElementType, TensorInfo},
};

use super::{
    description::{ChannelOrder, Fit, InputCrop, InputDescription, Layout},
    error::ModelError,
};
use crate::view::NoCrop;

/// Most pixels of an input: 200 MB for each image on its way.
const MOST_PIXELS: u64 = 1 << 24;

/// Colours of padding, in grey levels, where a description names none.
const BLACK: [f32; 3] = [0.0; 3];

/// An image as a model takes it, with what is needed to bring the model's map back to the image.
#[derive(Clone, Debug, PartialEq)]
pub struct ModelInput {
    /// `[3, height, width]` or, where the input is laid out so, `[height, width, 3]`.
    pub tensor: Vec<f32>,
    /// Width and height of the tensor in pixels.
    pub size: (u32, u32),
    /// Where in the tensor the picture lies; all of it, but for padding.
    pub filled: CropBox,
    /// The part of the image that the picture shows.
    pub shown: CropBox,
    /// Width and height of the image.
    pub image: (u32, u32),
    /// Focal length in pixels of the image, where it is known.
    pub focal_px: Option<f64>,
}

impl ModelInput {
    /// The tensor shows the whole image, without padding.
    pub(super) fn is_whole(&self) -> bool {
        self.filled == whole(self.size) && self.shown == whole(self.image)
    }

    /// Focal length in pixels of the picture in the tensor.
    pub(super) fn focal_in_tensor_px(&self) -> Option<f64> {
        let (filled, shown) = (self.filled, self.shown);
        let scale = (filled.right - filled.left) as f64 / (shown.right - shown.left) as f64;
        self.focal_px.map(|focal_px| focal_px * scale)
    }
}

fn whole((width, height): (u32, u32)) -> CropBox {
    CropBox {
        top: 0,
        bottom: height as usize,
        left: 0,
        right: width as usize,
    }
}

/// The box of a crop in an image.
fn crop_box(crop: InputCrop, (width, height): (u32, u32)) -> Result<CropBox, ModelError> {
    let ([top, bottom], [left, right]) = match crop {
        InputCrop::KittiBenchmark => {
            let (width, height) = (width as usize, height as usize);
            return Ok(benchmark_box(width, height).ok_or(NoCrop { width, height })?);
        }
        InputCrop::Pixels { rows, columns } => (rows, columns),
    };
    if bottom > height || right > width {
        return Err(ModelError::Crop {
            bottom,
            right,
            width,
            height,
        });
    }
    let [top, bottom, left, right] = [top, bottom, left, right].map(|edge| edge as usize);
    Ok(CropBox {
        top,
        bottom,
        left,
        right,
    })
}

/// Width and height of the tensor for a picture of this size, and the part of it that the picture fills.
fn fitted(input: &InputDescription, picture: (u32, u32)) -> ((u32, u32), CropBox) {
    if let (Some(width), Some(height)) = (input.width, input.height) {
        let size = (width, height);
        if input.fit == Fit::Stretch {
            return (size, whole(size));
        }
        let scale = [width, height].map(f64::from);
        let scale = (scale[0] / f64::from(picture.0)).min(scale[1] / f64::from(picture.1));
        // Rounded down, as the published scripts do, but never to nothing.
        let side = |side: u32, most: u32| ((f64::from(side) * scale) as u32).clamp(1, most);
        let (inner_width, inner_height) = (side(picture.0, width), side(picture.1, height));
        let (left, top) = ((width - inner_width) / 2, (height - inner_height) / 2);
        let filled = CropBox {
            top: top as usize,
            bottom: (top + inner_height) as usize,
            left: left as usize,
            right: (left + inner_width) as usize,
        };
        return (size, filled);
    }
    let (least, multiple) = (input.shorter_side, input.multiple_of.unwrap_or(1));
    let scale = least.map_or(1.0, |least| {
        f64::from(least) / f64::from(picture.0.min(picture.1).max(1))
    });
    let side = |side: u32| {
        let steps = f64::from(side) * scale / f64::from(multiple);
        let mut rounded = steps.round_ties_even() * f64::from(multiple);
        if least.is_some_and(|least| rounded < f64::from(least)) {
            rounded = steps.ceil() * f64::from(multiple);
        }
        (rounded as u32).max(multiple)
    };
    let size = (side(picture.0), side(picture.1));
    (size, whole(size))
}

/// Brings an image to the input's size and into its numbers. `focal_px` is that of the image, where it is
/// known.
///
/// # Errors
/// The image is smaller than the crop of the description, or its input would be too large.
pub fn prepare_input(
    image: &RgbImage,
    input: &InputDescription,
    focal_px: Option<f64>,
) -> Result<ModelInput, ModelError> {
    let shown = match input.crop {
        Some(crop) => crop_box(crop, image.dimensions())?,
        None => whole(image.dimensions()),
    };
    let cut;
    let picture = if shown == whole(image.dimensions()) {
        image
    } else {
        let [x, y] = [shown.left, shown.top].map(|edge| edge as u32);
        let (width, height) = (shown.right - shown.left, shown.bottom - shown.top);
        cut = image::imageops::crop_imm(image, x, y, width as u32, height as u32).to_image();
        &cut
    };
    let (size, filled) = fitted(input, picture.dimensions());
    if u64::from(size.0) * u64::from(size.1) > MOST_PIXELS {
        return Err(ModelError::TooLarge {
            width: size.0,
            height: size.1,
            most: MOST_PIXELS,
        });
    }
    let inner = (
        (filled.right - filled.left) as u32,
        (filled.bottom - filled.top) as u32,
    );
    let resized;
    let picture = if picture.dimensions() == inner {
        picture
    } else {
        resized = strat_store::resize::rgb(picture, inner.0, inner.1, input.kernel);
        &resized
    };
    Ok(ModelInput {
        tensor: tensor(picture, size, filled, input),
        size,
        filled,
        shown,
        image: image.dimensions(),
        focal_px,
    })
}

/// The numbers of a picture that fills a part of the tensor.
fn tensor(
    picture: &RgbImage,
    size: (u32, u32),
    filled: CropBox,
    input: &InputDescription,
) -> Vec<f32> {
    let (width, height) = (size.0 as usize, size.1 as usize);
    let plane = width * height;
    let mut tensor = vec![0.0; 3 * plane];
    for (index, values) in tensor.chunks_exact_mut(plane).enumerate() {
        let channel = match input.channels {
            ChannelOrder::Rgb => index,
            ChannelOrder::Bgr => 2 - index,
        };
        let (mean, std) = (input.mean[channel], input.std[channel]);
        let normal = |grey: f32| {
            let colour = match input.range {
                InputRange::Unit => grey / 255.0,
                InputRange::Bytes => grey,
            };
            (colour - mean) / std
        };
        if filled != whole(size) {
            values.fill(normal(input.pad.unwrap_or(BLACK)[channel]));
        }
        let rows = values.chunks_exact_mut(width).skip(filled.top);
        for (row, pixels) in rows.zip(picture.rows()) {
            for (value, pixel) in row[filled.left..].iter_mut().zip(pixels) {
                *value = normal(f32::from(pixel.0[channel]));
            }
        }
    }
    match input.layout {
        Layout::Nchw => tensor,
        Layout::Nhwc => {
            let [red, green, blue] = [0, 1, 2].map(|index| &tensor[index * plane..][..plane]);
            let pixels = red.iter().zip(green).zip(blue);
            pixels.flat_map(|((r, g), b)| [*r, *g, *b]).collect()
        }
    }
}

/// Mirrors an input left to right, in place: that of the mirrored image.
pub fn mirror_input(prepared: &mut ModelInput, input: &InputDescription) {
    let (width, image_width) = (prepared.size.0 as usize, prepared.image.0 as usize);
    let mirror = |part: &mut CropBox, width: usize| {
        (part.left, part.right) = (width - part.right, width - part.left);
    };
    mirror(&mut prepared.filled, width);
    mirror(&mut prepared.shown, image_width);
    let tensor = &mut prepared.tensor;
    match input.layout {
        Layout::Nchw => tensor.chunks_exact_mut(width).for_each(<[f32]>::reverse),
        Layout::Nhwc => {
            for row in tensor.chunks_exact_mut(3 * width) {
                row.reverse();
                // The channels of each pixel were turned round as well.
                row.chunks_exact_mut(3).for_each(<[f32]>::reverse);
            }
        }
    }
}

/// Name, type and shape of a tensor.
pub(super) fn tensor_text(tensor: &TensorInfo) -> String {
    let element = tensor.element.map(|element| format!(" {element}"));
    let dims = tensor
        .dims
        .as_deref()
        .map(|dims| format!(" {}", dims_text(dims)));
    format!(
        "`{}`{}{}",
        tensor.name,
        element.unwrap_or_default(),
        dims.unwrap_or_default()
    )
}

/// Types of elements that an image can be given in.
const ELEMENTS: [ElementType; 3] = [ElementType::F32, ElementType::F16, ElementType::U8];

/// Finds a wrong description before an image is decoded for nothing.
pub(super) fn check_input(tensor: &TensorInfo, input: &InputDescription) -> Result<(), String> {
    let name = &tensor.name;
    if let Some(element) = tensor.element.filter(|element| !ELEMENTS.contains(element)) {
        return Err(format!(
            "the input `{name}` takes {element}; images are given as f32, f16 or u8"
        ));
    }
    let pixels = input.width.zip(input.height);
    let pixels = pixels.map(|(width, height)| u64::from(width) * u64::from(height));
    if pixels.is_some_and(|pixels| pixels > MOST_PIXELS) {
        return Err(format!(
            "its input of {} has more than {MOST_PIXELS} pixels",
            input.size_text()
        ));
    }
    let is_grey =
        input.range == InputRange::Bytes && input.mean == [0.0; 3] && input.std == [1.0; 3];
    if tensor.element == Some(ElementType::U8) && !is_grey {
        return Err(format!(
            "the input `{name}` takes u8, whole numbers of 0 to 255: write `range: 0..255` and leave out \
             `mean` and `std`"
        ));
    }
    let (height, width) = (input.height, input.width);
    let side = |side: Option<u32>| side.map(|side| side as usize);
    let wanted = match input.layout {
        Layout::Nchw => [Some(1), Some(3), side(height), side(width)],
        Layout::Nhwc => [Some(1), side(height), side(width), Some(3)],
    };
    let Some(dims) = &tensor.dims else {
        return Ok(());
    };
    let shape = dims_text(dims);
    let fits = |(dim, size): (&Dim, Option<usize>)| match (dim.fixed(), size) {
        (Some(fixed), Some(size)) => fixed == size,
        (Some(_), None) => false,
        (None, _) => true,
    };
    if dims.len() == wanted.len() && dims.iter().zip(wanted).all(fits) {
        return Ok(());
    }
    if width.is_none() && dims.len() == wanted.len() {
        let sizes = dims.iter().zip(wanted).filter(|(_, size)| size.is_none());
        if sizes.filter(|(dim, _)| dim.fixed().is_some()).count() > 0 {
            return Err(format!(
                "the input `{name}` has the fixed shape {shape}, but the description lets the size depend \
                 on the image: write `width` and `height`, with `fit: stretch` or with `fit: keep-aspect` \
                 for padding"
            ));
        }
    }
    let other = match input.layout {
        Layout::Nchw => "nhwc",
        Layout::Nhwc => "nchw",
    };
    let text = |size: &Option<usize>| size.map_or_else(|| "?".to_owned(), |size| size.to_string());
    let wanted: Vec<String> = wanted.iter().map(text).collect();
    Err(format!(
        "the input `{name}` has the shape {shape}, but [{}] is to be given (width, height and \
         `layout: {other}` of the description decide)",
        wanted.join(", ")
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn dynamic(shorter_side: Option<u32>, multiple_of: u32) -> InputDescription {
        InputDescription {
            width: None,
            height: None,
            fit: Fit::KeepAspect,
            shorter_side,
            multiple_of: Some(multiple_of),
            ..InputDescription::fixed(1, 1, InputRange::Unit)
        }
    }

    #[test]
    fn inputs_are_normalised_by_channel() {
        let mut image = RgbImage::new(2, 1);
        image.put_pixel(0, 0, image::Rgb([255, 0, 51]));
        image.put_pixel(1, 0, image::Rgb([0, 102, 255]));
        let mut input = InputDescription::fixed(2, 1, InputRange::Unit);
        let prepared = |input: &InputDescription| prepare_input(&image, input, None).unwrap();
        assert_eq!(prepared(&input).tensor, [1.0, 0.0, 0.0, 0.4, 0.2, 1.0]);
        input.channels = ChannelOrder::Bgr;
        input.mean = [0.5, 0.0, 0.0];
        input.std = [0.5, 1.0, 1.0];
        assert_eq!(prepared(&input).tensor, [0.2, 1.0, 0.0, 0.4, 1.0, -1.0]);
        let mut mirrored = prepared(&input);
        mirror_input(&mut mirrored, &input);
        assert_eq!(mirrored.tensor, [1.0, 0.2, 0.4, 0.0, -1.0, 1.0]);

        input.layout = Layout::Nhwc;
        let mut mirrored = prepared(&input);
        assert_eq!(mirrored.tensor, [0.2, 0.0, 1.0, 1.0, 0.4, -1.0]);
        mirror_input(&mut mirrored, &input);
        assert_eq!(mirrored.tensor, [1.0, 0.4, -1.0, 0.2, 0.0, 1.0]);
    }

    /// The sizes of PROTOCOL 10.5.
    #[test]
    fn sizes_follow_from_the_image() {
        let size = |input: &InputDescription, image| fitted(input, image).0;
        let anything = dynamic(Some(518), 14);
        for image in [(1242, 375), (1226, 370)] {
            assert_eq!(size(&anything, image), (1722, 518), "{image:?}");
        }
        assert_eq!(size(&anything, (1216, 352)), (1792, 518));
        assert_eq!(size(&anything, (480, 640)), (518, 686));
        assert_eq!(size(&dynamic(Some(384), 32), (1242, 375)), (1280, 384));
        assert_eq!(size(&dynamic(None, 14), (640, 480)), (644, 476));
        assert_eq!(size(&dynamic(None, 32), (5, 5)), (32, 32));
        // Halves go to the even multiple: 21 / 14 to 2, 35 / 14 to 2.
        assert_eq!(size(&dynamic(None, 14), (21, 35)), (28, 28));
    }

    #[test]
    fn a_picture_that_keeps_its_aspect_is_padded() {
        let image = RgbImage::from_pixel(4, 2, image::Rgb([255, 255, 255]));
        let mut input = InputDescription::fixed(5, 5, InputRange::Bytes);
        input.fit = Fit::KeepAspect;
        input.pad = Some([7.0, 8.0, 9.5]);
        let mut prepared = prepare_input(&image, &input, Some(100.0)).unwrap();
        // Scale 5/4: 5 columns, 2 rows (2.5 rounded down), 1 row above.
        let filled = |top, bottom, left, right| CropBox {
            top,
            bottom,
            left,
            right,
        };
        assert_eq!(prepared.filled, filled(1, 3, 0, 5));
        assert_eq!(prepared.focal_in_tensor_px(), Some(125.0));
        assert!(!prepared.is_whole());
        assert_eq!(prepared.tensor[..5], [7.0; 5]);
        assert_eq!(prepared.tensor[5..15], [255.0; 10]);
        assert_eq!(prepared.tensor[65..], [9.5; 10]);
        (input.width, input.height) = (Some(6), Some(2));
        prepared = prepare_input(&image, &input, None).unwrap();
        assert_eq!(prepared.filled, filled(0, 2, 1, 5));
        mirror_input(&mut prepared, &input);
        assert_eq!(prepared.filled, filled(0, 2, 1, 5));
        assert_eq!(prepared.tensor[..6], [7.0, 255.0, 255.0, 255.0, 255.0, 7.0]);
    }

    #[test]
    fn the_kitti_benchmark_crop_is_at_the_bottom_in_the_middle() {
        let found = crop_box(InputCrop::KittiBenchmark, (1242, 375)).unwrap();
        assert_eq!(
            [found.top, found.bottom, found.left, found.right],
            [23, 375, 13, 1229]
        );
        let exact = crop_box(InputCrop::KittiBenchmark, (1216, 352)).unwrap();
        assert_eq!(exact, whole((1216, 352)));
        let error = crop_box(InputCrop::KittiBenchmark, (1215, 375)).unwrap_err();
        assert!(error.to_string().contains("1215x375"), "{error}");
    }

    fn tensor_info(element: ElementType, dims: [Dim; 4]) -> TensorInfo {
        TensorInfo {
            name: "image".to_owned(),
            element: Some(element),
            dims: Some(dims.into()),
        }
    }

    #[test]
    fn descriptions_that_do_not_fit_the_graph_are_refused() {
        let fixed = [1.into(), 3.into(), 518.into(), 518.into()];
        let open = [1.into(), 3.into(), "h".into(), "w".into()];
        let check = |element, dims: &[Dim; 4], input: &InputDescription| {
            check_input(&tensor_info(element, dims.clone()), input).unwrap_err()
        };
        let error = check(ElementType::F32, &fixed, &dynamic(Some(518), 14));
        assert!(error.contains("fixed shape"), "{error}");
        let input = InputDescription::fixed(518, 392, InputRange::Unit);
        let error = check(ElementType::F16, &fixed, &input);
        assert!(error.contains("[1, 3, 392, 518]"), "{error}");
        let error = check(ElementType::U8, &open, &input);
        assert!(error.contains("0..255"), "{error}");
        let error = check(ElementType(7), &open, &input);
        assert!(error.contains("i64"), "{error}");
        for input in [&input, &dynamic(Some(518), 14)] {
            assert_eq!(
                check_input(&tensor_info(ElementType::F16, open.clone()), input),
                Ok(())
            );
        }
    }
}
