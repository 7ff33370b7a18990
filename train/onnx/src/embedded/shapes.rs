//! What an operator makes of the shapes of its inputs, and of the few numbers that shapes are made of.
//!
//! Only operators that `forms` lets pass; of what is not followed (a reduction, a slice of an image) nothing is
//! known.

use crate::proto::{AttributeProto, NodeProto};

/// What is known of a value.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Known {
    pub shape: Option<Vec<u64>>,
    /// Its elements, where they are few and do not depend on the image.
    pub numbers: Option<Vec<f64>>,
}

/// A node with what is known of its inputs.
pub(super) struct Step<'a> {
    pub node: &'a NodeProto,
    pub inputs: Vec<&'a Known>,
}

impl Step<'_> {
    pub fn result(&self) -> Option<Known> {
        let shaped = |shape| Known {
            shape: Some(shape),
            numbers: None,
        };
        let op = self.node.op_type.as_deref()?;
        Some(match op {
            "Shape" => self.shape_of()?,
            "Cast" | "Identity" | "Floor" | "Ceil" => Known {
                shape: self.inputs.first()?.shape.clone(),
                numbers: self.numbers(0).map(|numbers| {
                    numbers
                        .iter()
                        .map(|v| match op {
                            "Floor" => v.floor(),
                            "Ceil" => v.ceil(),
                            "Cast" if self.attribute("to").and_then(|a| a.i) != Some(1) => {
                                v.trunc()
                            }
                            _ => *v,
                        })
                        .collect()
                }),
            },
            "Add" | "Sub" | "Mul" | "Div" => self.arithmetic(op),
            "Gather" => self.gathered()?,
            "Concat" => self.joined()?,
            "Slice" => self.sliced()?,
            "Unsqueeze" | "Squeeze" => self.squeezed(op)?,
            "Reshape" => Known {
                shape: Some(self.reshaped()?),
                numbers: self.numbers(0).map(<[f64]>::to_vec),
            },
            "Conv" => shaped(self.convolved()?),
            "ConvTranspose" => shaped(self.deconvolved()?),
            "MaxPool" | "AveragePool" => shaped(self.pooled()?),
            "Resize" | "Upsample" => shaped(self.resized(op)?),
            "Pad" => shaped(self.padded()?),
            "ConstantOfShape" => shaped(self.sizes(0)?),
            "Expand" => shaped(broadcast(self.shape(0)?, &self.sizes(1)?)),
            "Tile" => {
                let pairs = self.shape(0)?.iter().zip(self.sizes(1)?);
                shaped(
                    pairs
                        .map(|(size, times)| size.saturating_mul(times))
                        .collect(),
                )
            }
            "Range" => {
                let number = |index| self.numbers(index)?.first().copied();
                let (start, end, step) = (number(0)?, number(1)?, number(2)?);
                shaped(vec![((end - start) / step).ceil().max(0.0) as u64])
            }
            "MatMul" => shaped(self.product()?),
            "Gemm" => shaped(self.gemm()?),
            "Transpose" => shaped(self.transposed()?),
            "GlobalAveragePool" | "GlobalMaxPool" => {
                let shape = self.shape(0)?.iter().enumerate();
                shaped(
                    shape
                        .map(|(axis, size)| if axis < 2 { *size } else { 1 })
                        .collect(),
                )
            }
            "Max" | "Min" | "Sum" | "Mean" | "Pow" | "Where" | "PRelu" | "Mod" | "Equal"
            | "Greater" | "Less" | "GreaterOrEqual" | "LessOrEqual" | "And" | "Or" | "Xor" => {
                let mut shape = Vec::new();
                for index in 0..self.inputs.len() {
                    shape = broadcast(&shape, self.shape(index)?);
                }
                shaped(shape)
            }
            "Relu"
            | "Sigmoid"
            | "Tanh"
            | "Exp"
            | "Abs"
            | "Neg"
            | "Sin"
            | "Cos"
            | "Erf"
            | "Softplus"
            | "Softsign"
            | "Sqrt"
            | "Log"
            | "Elu"
            | "LeakyRelu"
            | "HardSigmoid"
            | "HardSwish"
            | "Gelu"
            | "Clip"
            | "BatchNormalization"
            | "InstanceNormalization"
            | "LayerNormalization"
            | "Softmax"
            | "LogSoftmax"
            | "Round"
            | "Sign"
            | "Not"
            | "Reciprocal" => shaped(self.shape(0)?.to_vec()),
            _ => return None,
        })
    }

    fn shape(&self, index: usize) -> Option<&[u64]> {
        self.inputs.get(index)?.shape.as_deref()
    }

    fn numbers(&self, index: usize) -> Option<&[f64]> {
        self.inputs.get(index)?.numbers.as_deref()
    }

    /// Numbers as sizes; negative ones are none.
    fn sizes(&self, index: usize) -> Option<Vec<u64>> {
        let numbers = self.numbers(index)?.iter();
        numbers
            .map(|value| (*value >= 0.0).then_some(*value as u64))
            .collect()
    }

    fn attribute(&self, name: &str) -> Option<&AttributeProto> {
        self.node
            .attribute
            .iter()
            .find(|a| a.name.as_deref() == Some(name))
    }

    fn int(&self, name: &str, default: i64) -> i64 {
        self.attribute(name).and_then(|a| a.i).unwrap_or(default)
    }

    /// An attribute's list, `default` repeated where it is absent or too short.
    fn list(&self, name: &str, count: usize, default: i64) -> Vec<u64> {
        let given = self.attribute(name).map_or(&[][..], |a| &a.ints);
        let value = |index: usize| given.get(index).copied().unwrap_or(default);
        (0..count)
            .map(|index| value(index).unsigned_abs())
            .collect()
    }

    /// An axis counted from the front.
    fn axis(&self, default: i64, rank: usize) -> Option<usize> {
        let axis = self.int("axis", default);
        let axis = if axis < 0 { axis + rank as i64 } else { axis };
        usize::try_from(axis).ok().filter(|axis| *axis < rank)
    }

    fn shape_of(&self) -> Option<Known> {
        let shape = self.shape(0)?;
        let place = |value: i64| {
            let value = if value < 0 {
                value + shape.len() as i64
            } else {
                value
            };
            usize::try_from(value).unwrap_or(0).min(shape.len())
        };
        let (start, end) = (
            place(self.int("start", 0)),
            place(self.int("end", i64::MAX)),
        );
        let part = shape.get(start..end)?;
        Some(Known {
            shape: Some(vec![part.len() as u64]),
            numbers: Some(part.iter().map(|size| *size as f64).collect()),
        })
    }

    fn arithmetic(&self, op: &str) -> Known {
        let shape = self
            .shape(0)
            .zip(self.shape(1))
            .map(|(a, b)| broadcast(a, b));
        let numbers = self.numbers(0).zip(self.numbers(1)).and_then(|(a, b)| {
            let count = a.len().max(b.len());
            let at = |values: &[f64], index: usize| {
                values
                    .get(if values.len() == 1 { 0 } else { index })
                    .copied()
            };
            let compute = |index| {
                let (a, b) = (at(a, index)?, at(b, index)?);
                Some(match op {
                    "Add" => a + b,
                    "Sub" => a - b,
                    "Mul" => a * b,
                    // Of whole numbers the quotient is cut; that of sizes may be too large by one here.
                    _ => a / b,
                })
            };
            (0..count).map(compute).collect()
        });
        Known { shape, numbers }
    }

    fn gathered(&self) -> Option<Known> {
        let shape = self.shape(0)?;
        let axis = self.axis(0, shape.len())?;
        let mut result = shape[..axis].to_vec();
        result.extend(self.shape(1)?);
        result.extend(&shape[axis + 1..]);
        let numbers = (shape.len() == 1).then_some(()).and_then(|()| {
            let from = self.numbers(0)?;
            let pick = |index: &f64| {
                let index = if *index < 0.0 {
                    index + from.len() as f64
                } else {
                    *index
                };
                from.get(index as usize).copied()
            };
            self.numbers(1)?.iter().map(pick).collect()
        });
        Some(Known {
            shape: Some(result),
            numbers,
        })
    }

    fn joined(&self) -> Option<Known> {
        let mut shape = self.shape(0)?.to_vec();
        let axis = self.axis(0, shape.len())?;
        for index in 1..self.inputs.len() {
            shape[axis] = shape[axis].saturating_add(*self.shape(index)?.get(axis)?);
        }
        let parts = (0..self.inputs.len()).map(|index| self.numbers(index));
        let numbers: Option<Vec<&[f64]>> = parts.collect();
        Some(Known {
            numbers: numbers
                .filter(|_| shape.len() == 1)
                .map(|parts| parts.concat()),
            shape: Some(shape),
        })
    }

    /// Slices of short lists alone: those that make shapes.
    fn sliced(&self) -> Option<Known> {
        let from = self.numbers(0)?;
        let one = |index| self.numbers(index)?.first().copied();
        if self.shape(0)?.len() != 1 || self.inputs.len() > 4 && one(4) != Some(1.0) {
            return None;
        }
        let place = |value: f64| {
            let value = if value < 0.0 {
                value + from.len() as f64
            } else {
                value
            };
            value.clamp(0.0, from.len() as f64) as usize
        };
        let part = from.get(place(one(1)?)..place(one(2)?))?;
        Some(Known {
            shape: Some(vec![part.len() as u64]),
            numbers: Some(part.to_vec()),
        })
    }

    fn squeezed(&self, op: &str) -> Option<Known> {
        let shape = self.shape(0)?;
        let given = self
            .attribute("axes")
            .map(|a| a.ints.iter().map(|v| *v as f64).collect());
        let axes: Vec<f64> = given.or_else(|| self.numbers(1).map(<[f64]>::to_vec))?;
        let rank = if op == "Squeeze" {
            shape.len()
        } else {
            shape.len() + axes.len()
        };
        let from_front = |axis: &f64| {
            if *axis < 0.0 {
                axis + rank as f64
            } else {
                *axis
            }
        };
        let axes: Vec<usize> = axes.iter().map(|axis| from_front(axis) as usize).collect();
        let mut left = shape.iter();
        let result = if op == "Squeeze" {
            let kept = left.enumerate().filter(|(axis, _)| !axes.contains(axis));
            kept.map(|(_, size)| *size).collect()
        } else {
            let size = |axis| {
                if axes.contains(&axis) {
                    Some(1)
                } else {
                    left.next().copied()
                }
            };
            (0..rank).map(size).collect::<Option<_>>()?
        };
        Some(Known {
            shape: Some(result),
            numbers: self.numbers(0).map(<[f64]>::to_vec),
        })
    }

    fn reshaped(&self) -> Option<Vec<u64>> {
        let shape = self.shape(0)?;
        let wanted = self.numbers(1)?;
        let all: u64 = shape.iter().product();
        let size = |(index, value): (usize, &f64)| match *value {
            0.0 if self.int("allowzero", 0) == 0 => shape.get(index).copied(),
            value => Some(value.max(1.0) as u64),
        };
        let mut result: Vec<u64> = wanted.iter().enumerate().map(size).collect::<Option<_>>()?;
        if let Some(free) = wanted.iter().position(|value| *value < 0.0) {
            result[free] = all.checked_div(result.iter().product())?;
        }
        Some(result)
    }

    /// Sizes of an image after a window has moved over it.
    fn windowed(&self, kernel: &[u64]) -> Option<Vec<u64>> {
        let image = self.shape(0)?.get(2..)?;
        let count = image.len();
        let strides = self.list("strides", count, 1);
        let dilations = self.list("dilations", count, 1);
        let pads = self.list("pads", 2 * count, 0);
        let auto = self.attribute("auto_pad").and_then(|a| a.s.as_deref());
        let size = |axis: usize| {
            let stride = strides[axis].max(1);
            if auto.is_some_and(|auto| auto.starts_with(b"SAME")) {
                return Some(image[axis].div_ceil(stride));
            }
            let reach = dilations[axis].checked_mul(kernel.get(axis)?.checked_sub(1)?)?;
            let padded = image[axis]
                .checked_add(pads[axis])?
                .checked_add(pads[axis + count])?;
            let rest = padded.checked_sub(reach.checked_add(1)?)?;
            // Rounded up where the node rounds up.
            let up = if self.int("ceil_mode", 0) == 0 {
                0
            } else {
                stride - 1
            };
            Some((rest + up) / stride + 1)
        };
        (0..count).map(size).collect()
    }

    fn convolved(&self) -> Option<Vec<u64>> {
        let weights = self.shape(1)?;
        let mut shape = vec![*self.shape(0)?.first()?, *weights.first()?];
        shape.extend(self.windowed(weights.get(2..)?)?);
        Some(shape)
    }

    fn pooled(&self) -> Option<Vec<u64>> {
        let image = self.shape(0)?;
        let kernel = self.list("kernel_shape", image.len().checked_sub(2)?, 1);
        let mut shape = image[..2].to_vec();
        shape.extend(self.windowed(&kernel)?);
        Some(shape)
    }

    fn deconvolved(&self) -> Option<Vec<u64>> {
        let (image, weights) = (self.shape(0)?, self.shape(1)?);
        let count = image.len().checked_sub(2)?;
        let strides = self.list("strides", count, 1);
        let dilations = self.list("dilations", count, 1);
        let pads = self.list("pads", 2 * count, 0);
        let more = self.list("output_padding", count, 0);
        let channels = weights
            .get(1)?
            .checked_mul(self.int("group", 1).unsigned_abs())?;
        let mut shape = vec![image[0], channels];
        for axis in 0..count {
            let reach = dilations[axis].checked_mul(weights.get(axis + 2)?.checked_sub(1)?)?;
            let full = image[axis + 2].checked_sub(1)?.checked_mul(strides[axis])?;
            let full = full
                .checked_add(reach)?
                .checked_add(1)?
                .checked_add(more[axis])?;
            shape.push(full.saturating_sub(pads[axis].saturating_add(pads[axis + count])));
        }
        Some(shape)
    }

    fn resized(&self, op: &str) -> Option<Vec<u64>> {
        let shape = self.shape(0)?;
        if let Some(sizes) = self.sizes(3) {
            return Some(sizes);
        }
        let given = self
            .attribute("scales")
            .map(|a| a.floats.iter().map(|v| f64::from(*v)).collect());
        let index = if op == "Upsample" { 1 } else { 2 };
        let scales: Vec<f64> = given.or_else(|| self.numbers(index).map(<[f64]>::to_vec))?;
        let pairs = shape.iter().zip(&scales);
        Some(
            pairs
                .map(|(size, scale)| (*size as f64 * scale) as u64)
                .collect(),
        )
    }

    fn padded(&self) -> Option<Vec<u64>> {
        let shape = self.shape(0)?;
        let given = self
            .attribute("pads")
            .map(|a| a.ints.iter().map(|v| *v as f64).collect());
        let pads: Vec<f64> = given.or_else(|| self.numbers(1).map(<[f64]>::to_vec))?;
        if pads.len() != 2 * shape.len() {
            return None;
        }
        let size = |(axis, size): (usize, &u64)| {
            (*size as f64 + pads[axis] + pads[axis + shape.len()]).max(0.0) as u64
        };
        Some(shape.iter().enumerate().map(size).collect())
    }

    fn product(&self) -> Option<Vec<u64>> {
        let (left, right) = (self.shape(0)?, self.shape(1)?);
        if left.len() < 2 || right.len() < 2 {
            return None;
        }
        let (batch, rows) = left.split_at(left.len() - 2);
        let (other, columns) = right.split_at(right.len() - 2);
        let mut shape = broadcast(batch, other);
        shape.extend([rows[0], columns[1]]);
        Some(shape)
    }

    fn gemm(&self) -> Option<Vec<u64>> {
        let size = |index: usize, name: &str, own: usize| {
            let axis = if self.int(name, 0) == 0 { own } else { 1 - own };
            self.shape(index)?.get(axis).copied()
        };
        Some(vec![size(0, "transA", 0)?, size(1, "transB", 1)?])
    }

    fn transposed(&self) -> Option<Vec<u64>> {
        let shape = self.shape(0)?;
        match self.attribute("perm") {
            None => Some(shape.iter().rev().copied().collect()),
            Some(order) => {
                let size = |axis: &i64| shape.get(usize::try_from(*axis).ok()?).copied();
                order.ints.iter().map(size).collect()
            }
        }
    }
}

/// The shape of two operands together; sizes that do not fit are the runtime's to refuse.
fn broadcast(a: &[u64], b: &[u64]) -> Vec<u64> {
    let rank = a.len().max(b.len());
    let size = |shape: &[u64], axis: usize| {
        (axis + shape.len())
            .checked_sub(rank)
            .map_or(1, |axis| shape[axis])
    };
    (0..rank)
        .map(|axis| size(a, axis).max(size(b, axis)))
        .collect()
}
