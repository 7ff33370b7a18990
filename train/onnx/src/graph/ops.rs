//! The operators, one method each.

use super::builder::{GraphBuilder, Source, Value};
use super::encode::{attribute_float, attribute_int, attribute_string, window_attributes};
use super::shapes::{
    Dim, Filter, Geometry, GraphError, check_bias, check_channels, check_filter, dims_text,
    merge_dims, shape_error, window_dims,
};
use crate::proto::AttributeProto;

impl GraphBuilder {
    /// `Conv`: `[N, in, h, w]` to `[N, out, h', w']` with
    /// `h' = (h + top + bottom - dilation * (kernel - 1) - 1) / stride + 1`, rounded down.
    ///
    /// # Errors
    /// The name is taken, or filter, geometry and input do not fit each other.
    pub fn conv(
        &mut self,
        name: &str,
        input: Value,
        filter: Filter,
        geometry: Geometry,
    ) -> Result<Value, GraphError> {
        let image = self.image_dims(name, input)?;
        check_filter(name, &filter, &geometry)?;
        let [out, in_per_group, kernel_h, kernel_w] = filter.shape;
        check_channels(name, &image[1], in_per_group * geometry.group)?;
        if !out.is_multiple_of(geometry.group) {
            return Err(shape_error(
                name,
                format!(
                    "{out} output channels cannot be divided into {} groups",
                    geometry.group
                ),
            ));
        }
        check_bias(name, &filter, out)?;
        let kernel = [kernel_h, kernel_w];
        let [height, width] = window_dims(name, &image, kernel, &geometry)?;
        let dims = vec![image[0].clone(), out.into(), height, width];
        self.convolution(name, "Conv", input, filter, geometry, dims)
    }

    /// `ConvTranspose`: `[N, in, h, w]` to `[N, out, h', w']` with
    /// `h' = (h - 1) * stride - top - bottom + dilation * (kernel - 1) + 1`. Kernel 4, stride 2,
    /// padding 1 doubles the size exactly.
    ///
    /// # Errors
    /// The name is taken, or filter, geometry and input do not fit each other.
    pub fn conv_transpose(
        &mut self,
        name: &str,
        input: Value,
        filter: Filter,
        geometry: Geometry,
    ) -> Result<Value, GraphError> {
        let image = self.image_dims(name, input)?;
        check_filter(name, &filter, &geometry)?;
        let [channels, out_per_group, kernel_h, kernel_w] = filter.shape;
        check_channels(name, &image[1], channels)?;
        if !channels.is_multiple_of(geometry.group) {
            return Err(shape_error(
                name,
                format!(
                    "{channels} input channels cannot be divided into {} groups",
                    geometry.group
                ),
            ));
        }
        let out = out_per_group * geometry.group;
        check_bias(name, &filter, out)?;
        let size = |axis: usize, kernel: usize| -> Result<Dim, GraphError> {
            let Some(size) = image[axis + 2].fixed() else {
                return Ok(Dim::Unknown);
            };
            let full = size.saturating_sub(1) * geometry.stride[axis]
                + geometry.dilation[axis] * (kernel - 1)
                + 1;
            match full.checked_sub(geometry.pads[axis] + geometry.pads[axis + 2]) {
                Some(size) if size > 0 => Ok(size.into()),
                _ => Err(shape_error(
                    name,
                    "the padding removes the whole result".into(),
                )),
            }
        };
        let dims = vec![
            image[0].clone(),
            out.into(),
            size(0, kernel_h)?,
            size(1, kernel_w)?,
        ];
        self.convolution(name, "ConvTranspose", input, filter, geometry, dims)
    }

    /// `MaxPool` over a window; padded pixels never win (they count as minus infinity, not zero).
    /// The group of the geometry is ignored. Rounds the size down.
    ///
    /// # Errors
    /// The name is taken or the window does not fit the input.
    pub fn max_pool(
        &mut self,
        name: &str,
        input: Value,
        kernel: usize,
        geometry: Geometry,
    ) -> Result<Value, GraphError> {
        let image = self.image_dims(name, input)?;
        let kernel = [kernel; 2];
        if geometry.pads.iter().any(|&pad| pad >= kernel[0]) {
            return Err(shape_error(
                name,
                "the padding must be smaller than the window".into(),
            ));
        }
        let [height, width] = window_dims(name, &image, kernel, &geometry)?;
        let dims = vec![image[0].clone(), image[1].clone(), height, width];
        let mut attributes = window_attributes(kernel, &geometry);
        attributes.push(attribute_int("ceil_mode", 0));
        self.node(
            name,
            "MaxPool",
            vec![Source::Value(input)],
            dims,
            attributes,
        )
    }

    /// `Pad` with zeros: rows and columns added at top, left, bottom and right.
    ///
    /// # Errors
    /// The name is taken or the input is not an image.
    pub fn pad_zero(
        &mut self,
        name: &str,
        input: Value,
        pads: [usize; 4],
    ) -> Result<Value, GraphError> {
        let mut dims = self.image_dims(name, input)?.to_vec();
        for axis in [0, 1] {
            if let Dim::Fixed(size) = &mut dims[axis + 2] {
                *size += pads[axis] + pads[axis + 2];
            } else if pads[axis] + pads[axis + 2] > 0 {
                dims[axis + 2] = Dim::Unknown;
            }
        }
        let [top, left, bottom, right] = pads.map(|pad| pad as i64);
        let amounts = [0, 0, top, left, 0, 0, bottom, right];
        let pads = self.constant_i64(&format!("{name}.pads"), &amounts)?;
        let zero = self.constant_f32(&format!("{name}.value"), &[], &[0.0])?;
        let inputs = vec![
            Source::Value(input),
            Source::Constant(pads),
            Source::Constant(zero),
        ];
        self.node(
            name,
            "Pad",
            inputs,
            dims,
            vec![attribute_string("mode", "constant")],
        )
    }

    /// `Resize` by the factor 2 in both directions, each pixel becoming a block of four.
    ///
    /// # Errors
    /// The name is taken or the input is not an image.
    pub fn nearest_x2(&mut self, name: &str, input: Value) -> Result<Value, GraphError> {
        let image = self.image_dims(name, input)?;
        let double = |dim: &Dim| {
            dim.fixed()
                .map_or(Dim::Unknown, |size| Dim::Fixed(size * 2))
        };
        let dims = vec![
            image[0].clone(),
            image[1].clone(),
            double(&image[2]),
            double(&image[3]),
        ];
        let scales = match &self.resize_scales {
            Some(scales) => scales.clone(),
            None => {
                let scales = self.constant_f32("resize_x2.scales", &[4], &[1.0, 1.0, 2.0, 2.0])?;
                self.resize_scales = Some(scales.clone());
                scales
            }
        };
        let attributes = vec![
            attribute_string("mode", "nearest"),
            attribute_string("coordinate_transformation_mode", "asymmetric"),
            attribute_string("nearest_mode", "floor"),
        ];
        let inputs = vec![
            Source::Value(input),
            Source::Absent,
            Source::Constant(scales),
        ];
        self.node(name, "Resize", inputs, dims, attributes)
    }

    /// `Elu` with alpha 1: `x` above zero, `exp(x) - 1` below.
    ///
    /// # Errors
    /// The name is taken.
    pub fn elu(&mut self, name: &str, input: Value) -> Result<Value, GraphError> {
        self.unary(name, "Elu", input, vec![attribute_float("alpha", 1.0)])
    }

    /// `Relu`: `max(x, 0)`.
    ///
    /// # Errors
    /// The name is taken.
    pub fn relu(&mut self, name: &str, input: Value) -> Result<Value, GraphError> {
        self.unary(name, "Relu", input, Vec::new())
    }

    /// `LeakyRelu`: `x` above zero, `slope * x` below.
    ///
    /// # Errors
    /// The name is taken.
    pub fn leaky_relu(
        &mut self,
        name: &str,
        input: Value,
        slope: f32,
    ) -> Result<Value, GraphError> {
        self.unary(
            name,
            "LeakyRelu",
            input,
            vec![attribute_float("alpha", slope)],
        )
    }

    /// `InstanceNormalization`: every channel of every sample gets mean 0 and (biased) variance 1 over its
    /// own pixels, `(x - mean) / sqrt(variance + epsilon)`, then its scale and shift.
    ///
    /// # Errors
    /// The name is taken, or there is not one scale and one shift for each channel.
    pub fn instance_norm(
        &mut self,
        name: &str,
        input: Value,
        [scale, shift]: [&[f32]; 2],
        epsilon: f32,
    ) -> Result<Value, GraphError> {
        let image = self.image_dims(name, input)?;
        for values in [scale, shift] {
            if image[1]
                .fixed()
                .is_some_and(|channels| channels != values.len())
            {
                let problem = format!(
                    "{} channels need as many scales and shifts, got {}",
                    image[1],
                    values.len()
                );
                return Err(shape_error(name, problem));
            }
        }
        let constant = |graph: &mut Self, part: &str, values: &[f32]| {
            graph.constant_f32(&format!("{name}.{part}"), &[values.len()], values)
        };
        let inputs = vec![
            Source::Value(input),
            Source::Constant(constant(self, "scale", scale)?),
            Source::Constant(constant(self, "shift", shift)?),
        ];
        let attributes = vec![attribute_float("epsilon", epsilon)];
        self.node(
            name,
            "InstanceNormalization",
            inputs,
            image.to_vec(),
            attributes,
        )
    }

    /// `Sigmoid`: `1 / (1 + exp(-x))`.
    ///
    /// # Errors
    /// The name is taken.
    pub fn sigmoid(&mut self, name: &str, input: Value) -> Result<Value, GraphError> {
        self.unary(name, "Sigmoid", input, Vec::new())
    }

    /// `Mul` of every element by a constant.
    ///
    /// # Errors
    /// The name is taken.
    pub fn scale(&mut self, name: &str, input: Value, factor: f32) -> Result<Value, GraphError> {
        let dims = self.slot(name, input)?.dims.clone();
        let factor = self.constant_f32(&format!("{name}.factor"), &[], &[factor])?;
        let inputs = vec![Source::Value(input), Source::Constant(factor)];
        self.node(name, "Mul", inputs, dims, Vec::new())
    }

    /// `Max` of every element and a constant.
    ///
    /// # Errors
    /// The name is taken.
    pub fn at_least(
        &mut self,
        name: &str,
        input: Value,
        minimum: f32,
    ) -> Result<Value, GraphError> {
        let dims = self.slot(name, input)?.dims.clone();
        let minimum = self.constant_f32(&format!("{name}.minimum"), &[], &[minimum])?;
        let inputs = vec![Source::Value(input), Source::Constant(minimum)];
        self.node(name, "Max", inputs, dims, Vec::new())
    }

    /// `Add` of two values of the same shape.
    ///
    /// # Errors
    /// The name is taken or the shapes differ.
    pub fn add(&mut self, name: &str, left: Value, right: Value) -> Result<Value, GraphError> {
        let (a, b) = (&self.slot(name, left)?.dims, &self.slot(name, right)?.dims);
        let Some(dims) = merge_dims(a, b, None) else {
            return Err(shape_error(
                name,
                format!("{} and {} cannot be added", dims_text(a), dims_text(b)),
            ));
        };
        let inputs = vec![Source::Value(left), Source::Value(right)];
        self.node(name, "Add", inputs, dims, Vec::new())
    }

    /// `Concat` along an axis (1 = channels); all other dimensions must agree.
    ///
    /// # Errors
    /// The name is taken, nothing was given, or the shapes do not agree.
    pub fn concat(
        &mut self,
        name: &str,
        values: &[Value],
        axis: usize,
    ) -> Result<Value, GraphError> {
        let Some((first, rest)) = values.split_first() else {
            return Err(shape_error(name, "there is nothing to concatenate".into()));
        };
        let mut dims = self.slot(name, *first)?.dims.clone();
        if axis >= dims.len() {
            return Err(shape_error(
                name,
                format!("{} has no axis {axis}", dims_text(&dims)),
            ));
        }
        for value in rest {
            let next = &self.slot(name, *value)?.dims;
            let Some(mut merged) = merge_dims(&dims, next, Some(axis)) else {
                return Err(shape_error(
                    name,
                    format!(
                        "{} and {} cannot be joined along axis {axis}",
                        dims_text(&dims),
                        dims_text(next)
                    ),
                ));
            };
            merged[axis] = match (dims[axis].fixed(), next[axis].fixed()) {
                (Some(a), Some(b)) => Dim::Fixed(a + b),
                _ => Dim::Unknown,
            };
            dims = merged;
        }
        let inputs = values.iter().map(|value| Source::Value(*value)).collect();
        let attributes = vec![attribute_int("axis", axis as i64)];
        self.node(name, "Concat", inputs, dims, attributes)
    }

    fn unary(
        &mut self,
        name: &str,
        op: &'static str,
        input: Value,
        attributes: Vec<AttributeProto>,
    ) -> Result<Value, GraphError> {
        let dims = self.slot(name, input)?.dims.clone();
        self.node(name, op, vec![Source::Value(input)], dims, attributes)
    }

    fn convolution(
        &mut self,
        name: &str,
        op: &'static str,
        input: Value,
        filter: Filter,
        geometry: Geometry,
        dims: Vec<Dim>,
    ) -> Result<Value, GraphError> {
        let kernel = [filter.shape[2], filter.shape[3]];
        let weights =
            self.constant_f32(&format!("{name}.weight"), &filter.shape, &filter.weights)?;
        let mut inputs = vec![Source::Value(input), Source::Constant(weights)];
        if !filter.bias.is_empty() {
            let bias = format!("{name}.bias");
            let bias = self.constant_f32(&bias, &[filter.bias.len()], &filter.bias)?;
            inputs.push(Source::Constant(bias));
        }
        let mut attributes = window_attributes(kernel, &geometry);
        attributes.push(attribute_int("group", geometry.group as i64));
        self.node(name, op, inputs, dims, attributes)
    }
}
