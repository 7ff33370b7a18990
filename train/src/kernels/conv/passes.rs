//! Convolutions and their gradients as matrix products, on plain slices.
//!
//! A convolution leads from a large image to a small one, the transposed convolution back; the weights
//! of both are `[small channels, large channels, k, k]`. So there are three passes: large to small, small
//! to large, and both to the weights.
//! The third is in [`super::weights`].
//!
//! Work is divided by shape alone, and partial sums are added in a fixed order.

use rten_simd::{Isa, SimdOp};

use super::super::activation::Activation;
use super::super::product::{Dense, multiply};
use super::geometry::Geometry;
use super::images::{Images, planes};
use super::phases::{Phase, arrange, interleave, pairs};
use super::pieces::{Piece, Source, each_chunk, each_sample, pieces, with_kept};
use super::windows::Layout;

/// What becomes of the sums of a pass.
#[derive(Clone, Copy)]
pub(super) struct Finish<'a> {
    /// A number for every channel.
    pub bias: Option<&'a [f32]>,
    /// Another image of the same shape to add.
    pub added: Option<&'a [f32]>,
    /// Applied to the sum of all.
    pub activation: Option<Activation>,
}

impl Finish<'_> {
    pub const NOTHING: Self = Self {
        bias: None,
        added: None,
        activation: None,
    };

    fn apply(&self, channel: usize, values: &mut [f32]) {
        let bias = self.bias.map_or(0.0, |bias| bias[channel]);
        let activation = self.activation;
        let applied = Applied {
            values,
            bias,
            activation,
        };
        applied.dispatch();
    }
}

/// Values that get a bias and an activation.
struct Applied<'a> {
    values: &'a mut [f32],
    bias: f32,
    activation: Option<Activation>,
}

impl SimdOp for Applied<'_> {
    type Output = ();

    #[inline(always)]
    fn eval<I: Isa>(self, _: I) {
        let bias = self.bias;
        let values = self.values.iter_mut();
        // One loop per function, each without a choice inside.
        match self.activation {
            None => values.for_each(|value| *value += bias),
            Some(Activation::Elu) => {
                values.for_each(|value| *value = Activation::Elu.value(*value + bias));
            }
            Some(Activation::LeakyRelu) => {
                values.for_each(|value| *value = Activation::LeakyRelu.value(*value + bias));
            }
        }
    }
}

impl Geometry {
    /// From the large image to the small one: a convolution.
    pub fn gather(&self, large: Images, weight: &[f32], finish: Finish) -> Vec<f32> {
        let [channels, height, width] = self.small;
        let plane = height * width;
        let depth = self.large[0] * self.kernel * self.kernel;
        let weight = Dense {
            values: weight,
            columns: depth,
        };
        let mut small = vec![0.0_f32; self.batch * channels * plane];
        let pieces = pieces(small.chunks_mut(plane.max(1)), self.batch, self.small, 1);
        self.source(large)
            .each_piece(pieces, &[self.places()], |piece, windows| {
                let Piece {
                    rows,
                    channels: own,
                    mut out,
                } = piece;
                let of_sample = rows.count * width;
                each_chunk(rows.positions(width), |columns| {
                    multiply(
                        &weight,
                        &windows[0],
                        own.clone(),
                        columns.clone(),
                        depth,
                        |row, values| {
                            let channel = own.start + row;
                            if let Some(added) = finish.added {
                                each_sample(columns.clone(), of_sample, |sample, place, from| {
                                    let image = (rows.sample + sample) * channels + channel;
                                    let start = image * plane + rows.first * width + from;
                                    let added = &added[start..start + place.len()];
                                    for (value, added) in values[place].iter_mut().zip(added) {
                                        *value += added;
                                    }
                                });
                            }
                            finish.apply(channel, values);
                            each_sample(columns.clone(), of_sample, |sample, place, to| {
                                let out = &mut out[sample * own.len() + row];
                                out[to..to + place.len()].copy_from_slice(&values[place]);
                            });
                        },
                    );
                });
            });
        small
    }

    /// From the small image to the large one: a transposed convolution, or the gradient of a convolution
    /// with respect to its input. Nothing can be [`Finish::added`]. The result may be several images, of so
    /// many channels each.
    ///
    /// With a stride the large image falls into that many interleaved ones in either direction; each is
    /// a convolution of the small image with its own part of the weights.
    pub fn scatter(
        &self,
        small: &[f32],
        weight: &[f32],
        finish: Finish,
        channels: &[usize],
    ) -> Vec<Vec<f32>> {
        let phases: Vec<Phase> = (0..self.stride)
            .map(|remainder| Phase::new(self, remainder))
            .collect();
        with_kept(weight.len(), |arranged| {
            arrange(self, weight, &phases, arranged);
            self.scatter_arranged(small, arranged, &phases, finish, channels)
        })
    }

    fn scatter_arranged(
        &self,
        small: &[f32],
        arranged: &[f32],
        phases: &[Phase],
        finish: Finish,
        channels: &[usize],
    ) -> Vec<Vec<f32>> {
        let ([_, height, width], stride) = (self.large, self.stride);
        let before = phases
            .iter()
            .map(|phase| (phase.taps).saturating_sub(phase.shift + 1));
        let before = before.max().unwrap_or(0);
        let after = phases.iter().map(|phase| phase.shift).max().unwrap_or(0);
        let columns = width.div_ceil(stride);
        let images = [(small, self.small[0])];
        let source = Source {
            images: Images(&images),
            size: self.small,
            layout: (!self.is_pointwise()).then_some(Layout {
                size: before + after + 1,
                stride: 1,
                before,
                columns,
            }),
        };
        let places: Vec<Vec<[usize; 2]>> = pairs(phases)
            .map(|[vertical, horizontal]| {
                let rows = vertical.offsets(before);
                rows.flat_map(|y| horizontal.offsets(before).map(move |x| [y, x]))
                    .collect()
            })
            .collect();
        let plane = height * width;
        let image = |channels: &usize| vec![0.0_f32; self.batch * channels * plane];
        let mut large: Vec<Vec<f32>> = channels.iter().map(image).collect();
        let planes = planes(&mut large, self.batch, channels, plane);
        let pieces = pieces(planes, self.batch, self.large, stride);
        source.each_piece(pieces, &places, |piece, windows| {
            let Piece {
                rows,
                channels: own,
                mut out,
            } = piece;
            let of_sample = rows.count * columns;
            let mut before = 0;
            for (number, windows) in windows.iter().enumerate() {
                let depth = windows.len();
                let weight = Dense {
                    values: &arranged[before..],
                    columns: self.small[0] * self.kernel * self.kernel,
                };
                before += depth;
                let phase = [stride, number / stride, number % stride];
                each_chunk(rows.positions(columns), |range| {
                    multiply(
                        &weight,
                        windows,
                        own.clone(),
                        range.clone(),
                        depth,
                        |row, values| {
                            finish.apply(own.start + row, values);
                            each_sample(range.clone(), of_sample, |sample, place, to| {
                                let out = &mut out[sample * own.len() + row];
                                let values = &values[place];
                                if stride == 1 {
                                    out[to..to + values.len()].copy_from_slice(values);
                                } else {
                                    interleave(out, values, to, columns, width, phase);
                                }
                            });
                        },
                    );
                });
            }
        });
        large
    }
}
