//! From the tensors that a model gives to the map of the left image.

use strat_store::raster::Plane;

use super::{
    description::{InputDescription, Layout, OutputDescription},
    error::{Implausible, ModelError},
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
/// `[h, w]`, and undoes what the description says was done to it. It shows what `input` shows.
pub(super) fn left_plane(
    output: Output,
    input: &InputDescription,
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
    plausible::check_values(&encoding, &data, width, input.width as usize)
        .map_err(|reason| implausible(&output.name, reason))?;
    encoding.apply(&mut data);
    Ok(Plane {
        width,
        height,
        data,
    })
}

#[cfg(test)]
mod tests {
    use strat_onnx::metadata::{InputRange, OutputMeaning};
    use strat_store::resize::Kernel;

    use super::*;
    use crate::model::ChannelOrder;

    /// Disparity in the given channel, channels first.
    fn channel(channel: usize) -> OutputDescription {
        OutputDescription {
            name: None,
            meaning: OutputMeaning::DisparityFraction,
            sigmoid: None,
            scale: None,
            channel,
            layout: Layout::Nchw,
        }
    }

    /// An input of the aspect of a map.
    fn input(width: u32, height: u32) -> InputDescription {
        InputDescription {
            name: None,
            width,
            height,
            range: InputRange::Unit,
            mean: [0.0; 3],
            std: [1.0; 3],
            channels: ChannelOrder::Rgb,
            layout: Layout::Nchw,
            kernel: Kernel::Area,
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
        let plane = left_plane(
            output(&[1, 2, 2, 3], data.clone()),
            &input(3, 2),
            &channel(0),
        )
        .unwrap();
        assert_eq!(plane.data, data[..6]);
        let plane = left_plane(
            output(&[1, 2, 2, 3], data.clone()),
            &input(3, 2),
            &channel(1),
        )
        .unwrap();
        assert_eq!(plane.data, data[6..]);
        assert_eq!((plane.width, plane.height), (3, 2));
        let plane =
            left_plane(output(&[1, 3, 4], data.clone()), &input(4, 3), &channel(0)).unwrap();
        assert_eq!((plane.width, plane.height), (4, 3));
        let last = OutputDescription {
            layout: Layout::Nhwc,
            ..channel(1)
        };
        let plane = left_plane(output(&[1, 2, 3, 2], data.clone()), &input(3, 2), &last).unwrap();
        assert_eq!(
            plane.data,
            [1.0, 3.0, 5.0, 7.0, 9.0, 11.0].map(|value| value / 12.0)
        );
        assert_eq!((plane.width, plane.height), (3, 2));
        for (shape, number) in [(&[2, 1, 2, 3][..], 0), (&[1, 2, 2, 3], 2), (&[12], 0)] {
            let error = left_plane(output(shape, data.clone()), &input(3, 2), &channel(number))
                .unwrap_err();
            assert!(error.to_string().contains("shape"), "{error}");
        }
    }

    #[test]
    fn a_value_that_is_no_number_is_named_with_its_place() {
        let mut data = vec![0.1; 6];
        data[4] = f32::NAN;
        data[5] = f32::INFINITY;
        let error = left_plane(output(&[1, 1, 2, 3], data), &input(3, 2), &channel(0)).unwrap_err();
        assert!(
            error.to_string().contains("row 1, column 1 (2 of 6 values"),
            "{error}"
        );
    }

    /// A network of channels last whose description says so of the input alone, and one that gives
    /// pixels for fractions.
    #[test]
    fn what_cannot_be_a_map_of_the_input_is_refused() {
        let one_row = output(&[1, 96, 160, 1], vec![0.1; 96 * 160]);
        let error = left_plane(one_row, &input(160, 96), &channel(0)).unwrap_err();
        assert!(error.to_string().contains("`layout`"), "{error}");
        let pixels = output(&[1, 1, 2, 3], vec![0.5, 12.0, 0.5, 0.5, 0.5, 0.5]);
        let error = left_plane(pixels, &input(3, 2), &channel(0)).unwrap_err();
        assert!(error.to_string().contains("disparity_px"), "{error}");
    }
}
