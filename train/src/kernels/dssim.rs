//! Structural dissimilarity and its gradient, row by row. The definition is [`crate::loss::dssim`].

use burn::backend::Flex;
use burn::backend::autodiff::checkpoint::base::Checkpointer;
use burn::backend::autodiff::checkpoint::strategy::NoCheckpointing;
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, Ops, OpsKind};
use burn::tensor::Tensor;
use rayon::prelude::*;

use super::cpu::{
    Cpu, Tracked, cpu_tensor, dims, from_plain, from_tracked, is_f32, tracked, values,
};

/// Structural dissimilarity of 3x3 windows on the CPU backend, `[n, c, h - 2, w - 2]`; `None`
/// elsewhere. See [`crate::loss::dssim`] for the definition.
pub(crate) fn dssim(x: &Tensor<4>, y: &Tensor<4>) -> Option<Tensor<4>> {
    if x.is_autodiff() || y.is_autodiff() {
        let (x, y) = (tracked(x)?, tracked(y)?);
        let suits = is_f32(x.primitive()) && is_f32(y.primitive());
        return suits.then(|| from_tracked(tracked_dssim(x, y)));
    }
    let x = x.clone().try_into_primitive::<Flex>().ok()?;
    let y = y.clone().try_into_primitive::<Flex>().ok()?;
    let suits = is_f32(&x) && is_f32(&y);
    suits.then(|| from_plain(similarity(&x.to_contiguous(), &y.to_contiguous())))
}

/// Windows are evaluated around half brightness: variances do not change, their rounding errors
/// shrink.
const MIDDLE: f32 = 0.5;

/// Statistics of one window of two images: means of the centred values, and the four factors of
/// S = A1 A2 / (B1 B2).
struct Window {
    centred_x: f32,
    centred_y: f32,
    /// 2 mu_x mu_y + C1 and mu_x^2 + mu_y^2 + C1.
    luminance: (f32, f32),
    /// 2 sigma_xy + C2 and sigma_x^2 + sigma_y^2 + C2.
    contrast: (f32, f32),
}

impl Window {
    /// From the sums of x, y, x^2, y^2 and xy over the window, centred.
    #[inline(always)]
    fn new(sums: [f32; 5]) -> Self {
        const C1: f32 = 0.01 * 0.01;
        const C2: f32 = 0.03 * 0.03;
        let [a, b, aa, bb, ab] = sums.map(|sum| sum * (1.0 / 9.0));
        let (x, y) = (a + MIDDLE, b + MIDDLE);
        Self {
            centred_x: a,
            centred_y: b,
            luminance: (2.0 * x * y + C1, x * x + y * y + C1),
            contrast: (2.0 * (ab - a * b) + C2, (aa - a * a) + (bb - b * b) + C2),
        }
    }

    #[inline(always)]
    fn similarity(&self) -> f32 {
        (self.luminance.0 * self.contrast.0) / (self.luminance.1 * self.contrast.1)
    }
}

/// Sums of x, y, x^2, y^2 and xy, centred, over the three rows of a row of windows, per column.
struct ColumnSums([Vec<f32>; 5]);

impl ColumnSums {
    fn new(width: usize) -> Self {
        Self(std::array::from_fn(|_| vec![0.0; width]))
    }

    /// Fills the sums for the windows whose first row is `row`.
    fn fill(&mut self, x: &[f32], y: &[f32], row: usize) {
        let [a, b, aa, bb, ab] = &mut self.0;
        let width = a.len();
        for sums in [&mut *a, &mut *b, &mut *aa, &mut *bb, &mut *ab] {
            sums.fill(0.0);
        }
        for line in row..row + 3 {
            let x = &x[line * width..(line + 1) * width];
            let y = &y[line * width..(line + 1) * width];
            for (sum, x) in a.iter_mut().zip(x) {
                *sum += x - MIDDLE;
            }
            for (sum, y) in b.iter_mut().zip(y) {
                *sum += y - MIDDLE;
            }
            for (sum, x) in aa.iter_mut().zip(x) {
                *sum += (x - MIDDLE) * (x - MIDDLE);
            }
            for (sum, y) in bb.iter_mut().zip(y) {
                *sum += (y - MIDDLE) * (y - MIDDLE);
            }
            for ((sum, x), y) in ab.iter_mut().zip(x).zip(y) {
                *sum += (x - MIDDLE) * (y - MIDDLE);
            }
        }
    }

    /// Calls `visit` with every window of the row and its column.
    #[inline(always)]
    fn windows(&self, mut visit: impl FnMut(usize, Window)) {
        let [a, b, aa, bb, ab] = &self.0;
        let columns = a.len() - 2;
        // Slices of one length let the compiler drop the bounds checks.
        let (a, b) = (&a[..columns + 2], &b[..columns + 2]);
        let (aa, bb, ab) = (&aa[..columns + 2], &bb[..columns + 2], &ab[..columns + 2]);
        for column in 0..columns {
            let sum = |values: &[f32]| values[column] + values[column + 1] + values[column + 2];
            visit(
                column,
                Window::new([sum(a), sum(b), sum(aa), sum(bb), sum(ab)]),
            );
        }
    }
}

fn similarity(x: &Cpu, y: &Cpu) -> Cpu {
    let [batch, channels, height, width] = dims(x);
    let (rows, columns) = (height - 2, width - 2);
    let plane = height * width;
    let mut output = vec![0.0_f32; batch * channels * rows * columns];
    output
        .par_chunks_mut((rows * columns).max(1))
        .zip(values(x).par_chunks(plane))
        .zip(values(y).par_chunks(plane))
        .for_each(|((output, x), y)| {
            let mut sums = ColumnSums::new(width);
            for (row, line) in output.chunks_exact_mut(columns.max(1)).enumerate() {
                sums.fill(x, y, row);
                sums.windows(|column, window| {
                    line[column] = ((1.0 - window.similarity()) * 0.5).clamp(0.0, 1.0);
                });
            }
        });
    cpu_tensor(output, &[batch, channels, rows, columns])
}

/// Gradient of the dissimilarity with respect to its first image.
///
/// With S = A1 A2 / (B1 B2) of [`Window`], a window's value depends on its pixels through the means
/// of x, of x^2 and of xy; each pixel collects the three derivatives of the windows it is in.
fn similarity_gradient(x: &Cpu, y: &Cpu, gradient: &Cpu) -> Cpu {
    let [_, _, height, width] = dims(x);
    let (rows, columns) = (height - 2, width - 2);
    let plane = height * width;
    let mut found = vec![0.0_f32; values(x).len()];
    found
        .par_chunks_mut(plane)
        .zip(values(x).par_chunks(plane))
        .zip(values(y).par_chunks(plane))
        .zip(values(gradient).par_chunks((rows * columns).max(1)))
        .for_each(|(((found, x), y), gradient)| {
            let mut sums = ColumnSums::new(width);
            // Derivatives by the means of x, x^2 and xy: of a row of windows, with two columns of
            // zeros on either side, and collected by pixel.
            let mut line: [Vec<f32>; 3] = std::array::from_fn(|_| vec![0.0; width + 2]);
            let mut collected: [Vec<f32>; 3] = std::array::from_fn(|_| vec![0.0; plane]);
            for row in 0..rows {
                sums.fill(x, y, row);
                let outer = &gradient[row * columns..(row + 1) * columns];
                let [by_mean, by_square, by_product] = &mut line;
                sums.windows(|column, window| {
                    let similarity = window.similarity();
                    let value = (1.0 - similarity) * 0.5;
                    let inside = (0.0..=1.0).contains(&value);
                    let outer = if inside { -0.5 * outer[column] } else { 0.0 };
                    let (a1, b1) = window.luminance;
                    let (a2, b2) = window.contrast;
                    let (a, b) = (window.centred_x, window.centred_y);
                    let both = 1.0 / (b1 * b2);
                    by_mean[column + 2] = outer
                        * (2.0 * both * ((b + MIDDLE) * a2 - b * a1)
                            + 2.0 * similarity * (a / b2 - (a + MIDDLE) / b1));
                    by_square[column + 2] = outer * -similarity / b2;
                    by_product[column + 2] = outer * 2.0 * a1 * both;
                });
                for (line, collected) in line.iter().zip(&mut collected) {
                    let parts = line[..width].iter().zip(&line[1..]).zip(&line[2..]);
                    let spread = &mut collected[row * width..(row + 3) * width];
                    let (first, rest) = spread.split_at_mut(width);
                    let (second, third) = rest.split_at_mut(width);
                    let pixels = first.iter_mut().zip(second).zip(third);
                    for (((first, second), third), ((a, b), c)) in pixels.zip(parts) {
                        let sum = a + b + c;
                        *first += sum;
                        *second += sum;
                        *third += sum;
                    }
                }
            }
            let [by_mean, by_square, by_product] = &collected;
            let derivatives = by_mean.iter().zip(by_square).zip(by_product);
            for ((found, (x, y)), ((mean, square), product)) in
                found.iter_mut().zip(x.iter().zip(y)).zip(derivatives)
            {
                *found =
                    (mean + 2.0 * (x - MIDDLE) * square + (y - MIDDLE) * product) * (1.0 / 9.0);
            }
        });
    cpu_tensor(found, &dims(x))
}

/// Backward step of the dissimilarity, which is symmetric in its two images.
#[derive(Debug)]
struct DssimGradient;

impl Backward<Flex, 2> for DssimGradient {
    type State = (Cpu, Cpu);

    fn backward(
        self,
        ops: Ops<Self::State, 2>,
        gradients: &mut Gradients,
        _checkpointer: &mut Checkpointer,
    ) {
        let [x_node, y_node] = ops.parents;
        let (x, y) = ops.state;
        let gradient = gradients.consume::<Flex>(&ops.node).to_contiguous();
        if let Some(node) = x_node {
            gradients.register::<Flex>(node.id, similarity_gradient(&x, &y, &gradient));
        }
        if let Some(node) = y_node {
            gradients.register::<Flex>(node.id, similarity_gradient(&y, &x, &gradient));
        }
    }
}

fn tracked_dssim(x: Tracked, y: Tracked) -> Tracked {
    let (x, x_node) = x.into_parts();
    let (y, y_node) = y.into_parts();
    let (x, y) = (x.to_contiguous(), y.to_contiguous());
    let output = similarity(&x, &y);
    match DssimGradient
        .prepare::<NoCheckpointing>([x_node, y_node])
        .compute_bound()
        .stateful()
    {
        OpsKind::Tracked(prepared) => prepared.finish((x, y), output),
        OpsKind::UnTracked(prepared) => prepared.finish(output),
    }
}
