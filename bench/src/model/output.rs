//! From the tensors that a model gives to the map of the left image.

use strat_onnx::metadata::OutputMeaning;
use strat_store::{
    raster::Plane,
    resize::{Alignment, Interpolation, interpolate_f32},
};

use super::{
    description::{Layout, OutputDescription},
    error::{Implausible, ModelError},
    input::ModelInput,
    plausible,
};
use crate::runtime::Output;

/// The output of this name.
pub(super) fn find(outputs: Vec<Output>, wanted: &str) -> Result<Output, ModelError> {
    let names: Vec<String> = outputs.iter().map(|output| output.name.clone()).collect();
    outputs
        .into_iter()
        .find(|output| output.name == wanted)
        .ok_or_else(|| ModelError::NoOutput {
            wanted: wanted.to_owned(),
            found: names.join(", "),
        })
}

/// Takes the left image's channel out of `[1, c, h, w]` or `[1, h, w, c]`, `[1, h, w]` or
/// `[h, w]`, and undoes what the description says was done to it. It shows what an input of `size`,
/// width and height, shows.
pub(super) fn left_plane(
    output: Output,
    size: (u32, u32),
    description: &OutputDescription,
) -> Result<Plane, ModelError> {
    let channel = description.channel;
    let (channels, height, width) = match (output.shape.as_slice(), description.layout) {
        (&[1, c, h, w], Layout::Nchw) | (&[1, h, w, c], Layout::Nhwc) => (c, h, w),
        (&[1, h, w] | &[h, w], _) => (1, h, w),
        _ => (0, 0, 0),
    };
    let plane = height.saturating_mul(width);
    let start = channel.saturating_mul(plane);
    if plane == 0 || channel >= channels || output.data.len() != channels.saturating_mul(plane) {
        return Err(ModelError::OutputShape {
            expected: match description.layout {
                Layout::Nchw => format!("[1, {} or more, height, width]", channel + 1),
                Layout::Nhwc => format!("[1, height, width, {} or more]", channel + 1),
            },
            found: output.shape,
            name: output.name,
        });
    }
    let implausible = |name: &str, reason: Implausible| ModelError::Implausible {
        name: name.to_owned(),
        reason,
    };
    let input = (size.0 as usize, size.1 as usize);
    plausible::check_output((width, height), input)
        .map_err(|reason| implausible(&output.name, reason))?;
    let mut data = output.data;
    match description.layout {
        Layout::Nchw => {
            data.truncate(start + plane);
            data.drain(..start);
        }
        Layout::Nhwc => data = data.into_iter().skip(channel).step_by(channels).collect(),
    }
    if let Some(first) = data.iter().position(|value| !value.is_finite()) {
        return Err(ModelError::NotFinite {
            name: output.name,
            row: first / width,
            column: first % width,
            count: data.iter().filter(|value| !value.is_finite()).count(),
            total: plane,
        });
    }
    let encoding = description.encoding();
    plausible::check_values(&encoding, &data, width, input.0)
        .map_err(|reason| implausible(&output.name, reason))?;
    encoding.apply(&mut data);
    Ok(Plane {
        width,
        height,
        data,
    })
}

/// Brings the map of an input back to the image that the input was made from: metres by the image's focal
/// length, without the padding, resized as the description says, and to its place. A map that shows the
/// whole image and is resized as all maps are stays at the network's size; where the model was shown a part
/// of the image, the rest of the map is 0.
pub(super) fn to_image(
    mut plane: Plane,
    input: &ModelInput,
    description: &OutputDescription,
) -> Result<Plane, ModelError> {
    if let Some(canonical_px) = description.canonical_focal_px {
        let focal_px = input
            .focal_in_tensor_px()
            .filter(|focal_px| *focal_px > 0.0);
        let factor = focal_px.ok_or(ModelError::NoFocal)? / canonical_px;
        for value in &mut plane.data {
            *value = (f64::from(*value) * factor) as f32;
        }
    }
    let (interpolation, alignment) = description.way_back();
    if input.is_whole() && (interpolation, alignment) == (Interpolation::Linear, Alignment::Edges) {
        return Ok(plane);
    }
    let plane = without_padding(plane, input);
    let shown = input.shown;
    let (width, height) = (shown.right - shown.left, shown.bottom - shown.top);
    // Of depth in metres 0 is none; without a unit it is a number like any other.
    let is_depth = description.meaning() == OutputMeaning::DepthM;
    let mut resized = interpolate_f32(&plane, width, height, interpolation, alignment);
    if is_depth {
        clear_mixed(&mut resized.data, &plane, |there| {
            interpolate_f32(there, width, height, Interpolation::Linear, alignment).data
        });
    }
    let (image_width, image_height) = (input.image.0 as usize, input.image.1 as usize);
    if (width, height) == (image_width, image_height) {
        return Ok(resized);
    }
    let mut whole = Plane::filled(image_width, image_height, 0.0);
    let rows = whole.data.chunks_exact_mut(image_width).skip(shown.top);
    for (row, values) in rows.zip(resized.data.chunks_exact(width)) {
        row[shown.left..shown.right].copy_from_slice(values);
    }
    Ok(whole)
}

/// The part of a map that the picture filled in the tensor, to the nearest pixel where the map is coarser.
fn without_padding(plane: Plane, input: &ModelInput) -> Plane {
    let (size, filled) = (input.size, input.filled);
    let edge = |at: usize, side: u32, of: usize| {
        (at as f64 * of as f64 / f64::from(side)).round() as usize
    };
    let [left, right] = [filled.left, filled.right].map(|at| edge(at, size.0, plane.width));
    let [top, bottom] = [filled.top, filled.bottom].map(|at| edge(at, size.1, plane.height));
    let (right, bottom) = (right.max(left + 1), bottom.max(top + 1));
    if (left, right, top, bottom) == (0, plane.width, 0, plane.height) {
        return plane;
    }
    let rows =
        (top..bottom.min(plane.height)).map(|row| &plane.row(row)[left..right.min(plane.width)]);
    let data: Vec<f32> = rows.flatten().copied().collect();
    let height = bottom.min(plane.height) - top;
    Plane {
        width: data.len() / height.max(1),
        height,
        data,
    }
}

/// Depth of 0 is none, so a pixel of a resized map that was mixed with none has none. `resize` does to a
/// plane, linearly, what was done to the map.
pub fn clear_mixed(resized: &mut [f32], plane: &Plane, resize: impl FnOnce(&Plane) -> Vec<f32>) {
    if plane.data.iter().all(|depth| *depth != 0.0) {
        return;
    }
    let is_there = |depth: &f32| if *depth == 0.0 { 0.0 } else { 1.0 };
    let there = Plane {
        data: plane.data.iter().map(is_there).collect(),
        ..*plane
    };
    for (depth, share) in resized.iter_mut().zip(resize(&there)) {
        if share < 0.9999 {
            *depth = 0.0;
        }
    }
}

#[cfg(test)]
mod tests {
    use strat_metrics::CropBox;
    use strat_store::resize::Kernel;

    use super::*;

    /// Disparity in the given channel, channels first.
    fn channel(channel: usize) -> OutputDescription {
        OutputDescription {
            channel,
            ..OutputDescription::plain(OutputMeaning::DisparityFraction)
        }
    }

    fn output(shape: &[usize], data: Vec<f32>) -> Output {
        Output {
            name: "disparity".to_owned(),
            shape: shape.to_vec(),
            data,
        }
    }

    #[test]
    fn the_left_plane_is_the_stated_channel() {
        let data: Vec<f32> = (0..12_u8).map(|value| f32::from(value) / 12.0).collect();
        let plane = left_plane(output(&[1, 2, 2, 3], data.clone()), (3, 2), &channel(0)).unwrap();
        assert_eq!(plane.data, data[..6]);
        let plane = left_plane(output(&[1, 2, 2, 3], data.clone()), (3, 2), &channel(1)).unwrap();
        assert_eq!(plane.data, data[6..]);
        assert_eq!((plane.width, plane.height), (3, 2));
        let plane = left_plane(output(&[1, 3, 4], data.clone()), (4, 3), &channel(0)).unwrap();
        assert_eq!((plane.width, plane.height), (4, 3));
        let last = OutputDescription {
            layout: Layout::Nhwc,
            ..channel(1)
        };
        let plane = left_plane(output(&[1, 2, 3, 2], data.clone()), (3, 2), &last).unwrap();
        assert_eq!(
            plane.data,
            [1.0, 3.0, 5.0, 7.0, 9.0, 11.0].map(|value| value / 12.0)
        );
        assert_eq!((plane.width, plane.height), (3, 2));
        for (shape, number) in [(&[2, 1, 2, 3][..], 0), (&[1, 2, 2, 3], 2), (&[12], 0)] {
            let error =
                left_plane(output(shape, data.clone()), (3, 2), &channel(number)).unwrap_err();
            assert!(error.to_string().contains("shape"), "{error}");
        }
    }

    #[test]
    fn a_value_that_is_no_number_is_named_with_its_place() {
        let mut data = vec![0.1; 6];
        data[4] = f32::NAN;
        data[5] = f32::INFINITY;
        let error = left_plane(output(&[1, 1, 2, 3], data), (3, 2), &channel(0)).unwrap_err();
        assert!(
            error.to_string().contains("row 1, column 1 (2 of 6 values"),
            "{error}"
        );
    }

    fn part(top: usize, bottom: usize, left: usize, right: usize) -> CropBox {
        CropBox {
            top,
            bottom,
            left,
            right,
        }
    }

    fn depth() -> OutputDescription {
        OutputDescription::plain(OutputMeaning::DepthM)
    }

    /// A picture in a tensor of 4x4 that shows columns 1 to 3 of an image of 4x1, with two rows of padding.
    fn padded() -> ModelInput {
        ModelInput {
            tensor: Vec::new(),
            size: (4, 4),
            filled: part(1, 3, 0, 4),
            shown: part(0, 1, 1, 3),
            image: (4, 1),
            focal_px: Some(50.0),
        }
    }

    #[test]
    fn maps_return_to_their_place_in_the_image() {
        let columns = [2.0, 4.0, 6.0, 8.0];
        let data: Vec<f32> = [[9.0; 4], columns, columns, [9.0; 4]].concat();
        let plane = Plane::new(4, 4, data).unwrap();
        let back = to_image(plane.clone(), &padded(), &depth()).unwrap();
        assert_eq!((back.width, back.height), (4, 1));
        assert_eq!(back.data, [0.0, 3.0, 7.0, 0.0]);
        let corners = OutputDescription {
            align_corners: true,
            ..depth()
        };
        let back = to_image(plane.clone(), &padded(), &corners).unwrap();
        assert_eq!(back.data, [0.0, 2.0, 8.0, 0.0]);
        // 50 px at the image are 100 px in the tensor, a fifth of the canonical focal length.
        let canonical = OutputDescription {
            canonical_focal_px: Some(500.0),
            ..depth()
        };
        let back = to_image(plane.clone(), &padded(), &canonical).unwrap();
        assert!((back.data[1] - 0.6).abs() < 1e-6, "{:?}", back.data);
        let unknown = ModelInput {
            focal_px: None,
            ..padded()
        };
        let error = to_image(plane.clone(), &unknown, &canonical).unwrap_err();
        assert!(error.to_string().contains("focal length"), "{error}");
        // Half as many rows and columns.
        let coarse = Plane::new(2, 2, vec![3.0, 7.0, 3.0, 7.0]).unwrap();
        let back = to_image(coarse, &padded(), &depth()).unwrap();
        assert_eq!(back.data, [0.0, 3.0, 7.0, 0.0]);
    }

    #[test]
    fn whole_maps_are_resized_here_only_if_the_description_says_how() {
        let input = ModelInput {
            filled: part(0, 1, 0, 3),
            shown: part(0, 1, 0, 5),
            size: (3, 1),
            image: (5, 1),
            ..padded()
        };
        let plane = Plane::new(3, 1, vec![0.0, 4.0, 4.0]).unwrap();
        let back = |description: &OutputDescription| {
            to_image(plane.clone(), &input, description).unwrap().data
        };
        assert_eq!(back(&depth()), plane.data);
        let corners = OutputDescription {
            align_corners: true,
            ..OutputDescription::plain(OutputMeaning::InverseDepth)
        };
        assert_eq!(back(&corners), [0.0, 2.0, 4.0, 4.0, 4.0]);
        // Depth of 0 is none and is not mixed with depth.
        let corners = OutputDescription {
            align_corners: true,
            ..depth()
        };
        assert_eq!(back(&corners), [0.0, 0.0, 4.0, 4.0, 4.0]);
        let cubic = OutputDescription {
            kernel: Some(Kernel::OpencvCubic),
            ..OutputDescription::plain(OutputMeaning::InverseDepth)
        };
        // Cubic overshoots behind an edge.
        assert!(back(&cubic)[3] > 4.0);
    }

    /// A network of channels last whose description says so of the input alone, and one that gives
    /// pixels for fractions.
    #[test]
    fn what_cannot_be_a_map_of_the_input_is_refused() {
        let one_row = output(&[1, 96, 160, 1], vec![0.1; 96 * 160]);
        let error = left_plane(one_row, (160, 96), &channel(0)).unwrap_err();
        assert!(error.to_string().contains("`layout`"), "{error}");
        let pixels = output(&[1, 1, 2, 3], vec![0.5, 12.0, 0.5, 0.5, 0.5, 0.5]);
        let error = left_plane(pixels, (3, 2), &channel(0)).unwrap_err();
        assert!(error.to_string().contains("disparity_px"), "{error}");
    }
}
