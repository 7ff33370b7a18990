//! From an image to the tensor that a model takes.

use image::RgbImage;
use strat_onnx::{
    graph::{Dim, dims_text},
    metadata::InputRange,
    model::{ElementType, TensorInfo},
};

use super::description::{ChannelOrder, InputDescription, Layout};

/// Most pixels of an input: 200 MB for each image on its way.
const MOST_PIXELS: usize = 1 << 24;

/// Brings an image to the input size and into the input's numbers, `[3, height, width]` or, where
/// the input is laid out so, `[height, width, 3]`.
#[must_use]
pub fn prepare_input(image: &RgbImage, input: &InputDescription) -> Vec<f32> {
    let resized;
    let image = if image.dimensions() == (input.width, input.height) {
        image
    } else {
        resized = strat_store::resize::rgb(image, input.width, input.height, input.kernel);
        &resized
    };
    let plane = input.width as usize * input.height as usize;
    let mut tensor = vec![0.0; 3 * plane];
    for (index, values) in tensor.chunks_exact_mut(plane).enumerate() {
        let channel = match input.channels {
            ChannelOrder::Rgb => index,
            ChannelOrder::Bgr => 2 - index,
        };
        let (mean, std) = (input.mean[channel], input.std[channel]);
        for (value, pixel) in values.iter_mut().zip(image.pixels()) {
            let byte = f32::from(pixel.0[channel]);
            let colour = match input.range {
                InputRange::Unit => byte / 255.0,
                InputRange::Bytes => byte,
            };
            *value = (colour - mean) / std;
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

/// Mirrors an input of [`prepare_input`] left to right, in place.
pub fn mirror_input(tensor: &mut [f32], input: &InputDescription) {
    let width = input.width as usize;
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

/// Finds a wrong description before an image is decoded for nothing.
pub(super) fn check_input(tensor: &TensorInfo, input: &InputDescription) -> Result<(), String> {
    if let Some(element) = tensor
        .element
        .filter(|&element| element != ElementType::F32)
    {
        return Err(format!(
            "the input `{}` takes {element}, only f32 is supported",
            tensor.name
        ));
    }
    let (height, width) = (input.height as usize, input.width as usize);
    if height.saturating_mul(width) > MOST_PIXELS {
        return Err(format!(
            "its input of {width} x {height} has more than {MOST_PIXELS} pixels"
        ));
    }
    let wanted = match input.layout {
        Layout::Nchw => [1, 3, height, width],
        Layout::Nhwc => [1, height, width, 3],
    };
    let fits = tensor.dims.as_ref().is_none_or(|dims| {
        dims.len() == wanted.len()
            && dims
                .iter()
                .zip(wanted)
                .all(|(dim, size)| Dim::fixed(dim).is_none_or(|fixed| fixed == size))
    });
    if fits {
        return Ok(());
    }
    let other = match input.layout {
        Layout::Nchw => "nhwc",
        Layout::Nhwc => "nchw",
    };
    Err(format!(
        "the input `{}` has the shape {}, but {wanted:?} is to be given (width, height and \
         `layout: {other}` of the description decide)",
        tensor.name,
        tensor.dims.as_deref().map(dims_text).unwrap_or_default()
    ))
}

#[cfg(test)]
mod tests {
    use strat_store::resize::Kernel;

    use super::*;

    #[test]
    fn inputs_are_normalised_by_channel() {
        let mut image = RgbImage::new(2, 1);
        image.put_pixel(0, 0, image::Rgb([255, 0, 51]));
        image.put_pixel(1, 0, image::Rgb([0, 102, 255]));
        let mut input = InputDescription {
            name: None,
            width: 2,
            height: 1,
            range: InputRange::Unit,
            mean: [0.0; 3],
            std: [1.0; 3],
            channels: ChannelOrder::Rgb,
            layout: Layout::Nchw,
            kernel: Kernel::Area,
        };
        assert_eq!(
            prepare_input(&image, &input),
            [1.0, 0.0, 0.0, 0.4, 0.2, 1.0]
        );
        input.channels = ChannelOrder::Bgr;
        input.mean = [0.5, 0.0, 0.0];
        input.std = [0.5, 1.0, 1.0];
        assert_eq!(
            prepare_input(&image, &input),
            [0.2, 1.0, 0.0, 0.4, 1.0, -1.0]
        );
        let mut tensor = prepare_input(&image, &input);
        mirror_input(&mut tensor, &input);
        assert_eq!(tensor, [1.0, 0.2, 0.4, 0.0, -1.0, 1.0]);

        input.layout = Layout::Nhwc;
        let mut tensor = prepare_input(&image, &input);
        assert_eq!(tensor, [0.2, 0.0, 1.0, 1.0, 0.4, -1.0]);
        mirror_input(&mut tensor, &input);
        assert_eq!(tensor, [1.0, 0.4, -1.0, 0.2, 0.0, 1.0]);
    }
}
